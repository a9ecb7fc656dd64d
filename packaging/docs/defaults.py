"""
Makes docs/defaults.md: the options of clients from their rows, and those of servers, gateways and
fleets from the docstrings and fields of their classes. usage: defaults.py [--check]
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from libmodbus_py import Point
from libmodbus_py.client.options import AsyncOptions
from libmodbus_py.ports.options import SERIAL_OPTIONS, rows_of
from libmodbus_py.server.limits import Limits
from libmodbus_py.services.fleet.config import DeviceConfig
from libmodbus_py.services.gateway.gateway import Gateway
from libmodbus_py.services.gateway.routes import GatewayOptions

PAGE = Path(__file__).parents[2] / "docs" / "defaults.md"

HEAD = """\
<!-- Generated from the options of the code by packaging/docs/defaults.py; do not edit. -->

# Defaults

These are the options of clients, servers, gateways and fleets, and the keys of points, with their
defaults. Times are in seconds.

## Clients

Options of both clients, as arguments or in a URL, which takes those above `security`.
Arguments take precedence.
"""

SERIAL = """\
Options of clients whose URL is that of a [serial port](how-to/serial-ports.md), and
settings of such URLs everywhere. With `ascii://`, `data_bits` is 7.
"""

DEVICES = """\
Keys of `[[device]]` and `[defaults]` in a [fleet file](how-to/fleet.md), and arguments of
`DeviceConfig`; `name`, `url` and `map` have no default.
"""

POINTS = """\
Keys of a point of a [register map](how-to/register-maps.md), in TOML and as columns in
CSV, and arguments of `Point`; `name`, `table` and `address` have no default.
"""

LINKS = {
    "sent again": "how-to/timeouts.md#retries",
    "reads in flight": "how-to/many-requests.md",
    "device that connects": "how-to/devices-that-connect.md",
    "write values": "how-to/register-maps.md#all-keys-of-a-point",
    "the client's certificate": "how-to/tls.md",
    "every frame": "how-to/errors.md#see-the-frames",
    "contain its statistics": "how-to/gateways.md#the-gateways-own-registers",
    "unneeded registers": "how-to/fleet.md#how-many-devices",
    "workers poll": "how-to/several-machines.md",
}
"""Words of the texts -> the page that says more."""


def table(rows: Iterator[tuple[str, Any, str]]) -> str:
    """Return the table of options: name, default and text of each."""
    lines = ["| option | default | meaning |", "|---|---|---|"]
    for name, default, text in rows:
        shown = repr(default).replace("'", '"')
        lines.append(f"| `{name}` | `{shown}` | {text.replace('``', '`')} |")
    text = "\n".join(lines) + "\n"
    for words, page in LINKS.items():
        text = text.replace(words, f"[{words}]({page})", 1)
    return text


def of_fields(cls: Any, described: Any = None) -> Iterator[tuple[str, Any, str]]:
    """Yield name, default and text of each argument of a dataclass that has a default."""
    part = (inspect.getdoc(described or cls) or "").partition("Args:\n")[2].partition("\n\n")[0]
    texts = re.findall(r"(?ms)^ {4}([\w, ]+): (.+?)(?=^ {4}\w|\Z)", part)
    meanings = {name: " ".join(text.split()) for names, text in texts for name in names.split(", ")}
    for field in fields(cls):
        if field.init and field.default_factory is not MISSING:
            yield field.name, field.default_factory(), meanings[field.name]
        elif field.init and field.default is not MISSING:
            yield field.name, field.default, meanings[field.name]


def page() -> str:
    """Return the page."""
    rows = [(name, row.default, row.text) for name, row in rows_of(AsyncOptions).items()]
    return "\n".join(
        [
            HEAD,
            table(row for row in rows if row[0] not in SERIAL_OPTIONS),
            "## Serial ports\n",
            SERIAL,
            table(row for row in rows if row[0] in SERIAL_OPTIONS),
            "## Limits of servers and gateways\n",
            table(of_fields(Limits)),
            "## Gateways\n",
            table(of_fields(GatewayOptions, Gateway)),
            "## Devices of a fleet\n",
            DEVICES,
            table(of_fields(DeviceConfig)),
            "## Points of a register map\n",
            POINTS,
            table(of_fields(Point)),
        ]
    )


def main() -> int:
    is_check = sys.argv[1:] == ["--check"]
    if PAGE.read_text(encoding="utf-8") == page():
        return 0
    print(f"docs/defaults.md: {'not what defaults.py makes' if is_check else 'written'}")
    if not is_check:
        PAGE.write_text(page(), encoding="utf-8")
    return int(is_check)


if __name__ == "__main__":
    sys.exit(main())
