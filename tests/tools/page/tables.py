"""A page of tables with values that a test puts."""

import contextlib
import time
from collections.abc import Iterator
from typing import Any

from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.table_source import COLUMNS, ShownPoint, TableSource, Values
from libmodbus_py.tools.page.text import cell_text
from tests.tools.page.watching import Visitor

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


def name_of(cells: dict[str, Any]) -> list[str]:
    """Return the parts of the name of a row that are not empty."""
    return [part for part in cells["name"].values() if part]


def state_of(cells: dict[str, Any]) -> list[Any]:
    """Return the word, the reason and the time of the state of a row."""
    state = cells["state"]
    return [state["word"], state.get("reason", ""), state.get("since", 0)]


class Meter:
    """See `GroupRow`: a device that is up unless a test says why it is not."""

    answered_at = 0.0

    def __init__(self, name: str) -> None:
        self.name = self.words = name
        self.reason = ""

    @property
    def is_down(self) -> bool:
        return bool(self.reason)

    is_problem = is_down

    def cells(self) -> dict[str, Any]:
        word = "down" if self.reason else "up"
        return {
            "name": {"group": "", "own": cell_text(self.name)},
            "state": {"word": word, "reason": self.reason, "since": 1000.0},
            "value": {"text": "", "units": ""},
        }


class Plant:
    """See `Shown` of the page: values of devices, by their names."""

    kind = "fleet"
    log = None
    columns = COLUMNS

    def __init__(self, title: str = "plant.toml", older: Any = None) -> None:
        self.title = title
        self.older = older
        self.meters: dict[str, Meter] = {}
        self.values = Values(lambda name: self.meters.setdefault(name, Meter(name)))
        self.counts: dict[str, float] = {"devices": 1, "down": 0}

    def describe(self, *points: tuple[str, str], every: float | None = 1.0) -> None:
        self.values.describe(ShownPoint(*names, "V", every) for names in points)

    def status(self) -> tuple[str, bool]:
        down = sum(meter.is_down for meter in self.meters.values())
        return f"{down} of {len(self.meters)} devices down", down > 0

    def figures(self) -> dict[str, float]:
        return self.counts

    def rows(self) -> list[Any]:
        return self.values.rows

    def series(self, name: tuple[str, str], column: str) -> Any:
        return self.values.series(name, column)

    def put(self, device: str, name: str, value: Any, at: float | None = None, **more: Any) -> None:
        quality = more.get("quality", "good" if value is not None else "bad")
        moment = time.time() if at is None else at
        self.values.put_readings(
            [(moment, device, name, value, "V", quality, more.get("reason", ""))]
        )


@contextlib.contextmanager
def visited(plant: Plant) -> Iterator[Visitor]:
    """Somebody who watches its page without a browser."""
    with table_page(TableSource(plant)) as page, Visitor(page.url).watching() as visitor:
        yield visitor
