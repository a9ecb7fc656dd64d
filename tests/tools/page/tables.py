"""
A page of tables with values that a test puts.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.table_source import TableSource
from libmodbus_py.tools.page.tables import ValuesTable
from tests.tools.page.watching import Visitor

__all__ = ["HOSTILE", "Plant", "visited"]

HOSTILE = (
    "<script>document.title='hit'</script>",
    '"><img src=x onerror="document.title=\'hit\'">',
    "__proto__",
    "constructor",
    "\u202egnp.exe",
    "a\nb\x00c\x1b[2J",
    "</td></tr></table>",
    "{{7*7}}",
)


class Plant:
    """See `Shown` of the page: values of devices, by their names."""

    kind = "fleet"
    log = None

    def __init__(
        self, title: str = "plant.toml", older: Any = None, stepped: str | None = None
    ) -> None:
        self.title = title
        self.older = older
        self.values = ValuesTable(is_stepped=lambda device, name: name == stepped)
        self.tables = [self.values]
        self.counts: dict[str, float] = {"devices": 1, "down": 0}

    def figures(self) -> dict[str, float]:
        return self.counts

    def put(self, device: str, name: str, value: Any, at: float | None = None, **more: Any) -> None:
        quality = more.get("quality", "good" if value is not None else "bad")
        moment = time.time() if at is None else at
        self.values.put([(moment, device, name, value, "V", quality, more.get("reason", ""))])


@contextlib.contextmanager
def visited(plant: Plant) -> Iterator[Visitor]:
    """Somebody who watches its page without a browser."""
    with table_page(TableSource(plant)) as page, Visitor(page.url).watching() as visitor:
        yield visitor
