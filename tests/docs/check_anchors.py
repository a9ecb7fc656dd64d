"""
Compare what is public with what the built documentation has: ``check_anchors.py site``.

Ends with 1 if a public name has no place in the API pages.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path

PUBLIC = [
    "libmodbus_py",
    "libmodbus_py.bound",
    "libmodbus_py.device_file",
    "libmodbus_py.errors",
    "libmodbus_py.fleet",
    "libmodbus_py.framing",
    "libmodbus_py.listen",
    "libmodbus_py.low_level",
    "libmodbus_py.page",
    "libmodbus_py.prometheus",
    "libmodbus_py.protocol.pdu",  # where griffe finds what `libmodbus_py.pdu` stands for
    "libmodbus_py.scan",
    "libmodbus_py.serve",
    "libmodbus_py.testing",
    "libmodbus_py.values",
]

if importlib.util.find_spec("modbus_connection"):  # Python 3.11 has none
    PUBLIC.append("libmodbus_py.modbus_connection")


def anchors(site: Path) -> set[str]:
    pages = (site / "api").rglob("*.html")
    return {name for page in pages for name in re.findall(r'id="([\w.]+)"', page.read_text())}


def public() -> list[str]:
    top = importlib.import_module("libmodbus_py").__all__
    return [f"libmodbus_py.{name}" for name in top] + [
        f"{module}.{name}"
        for module in PUBLIC[1:]
        for name in importlib.import_module(module).__all__
        if name not in top  # elsewhere, it is the same one again
    ]


def main(site: str) -> int:
    missing = sorted({*public()} - anchors(Path(site)))
    for name in missing:
        print(f"{name} is public, and has no place in docs/api", file=sys.stderr)
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
