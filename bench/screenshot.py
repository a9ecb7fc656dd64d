"""
Takes the picture of the live page, docs/page.png: ./run python -m bench.screenshot [FILE]

The example meter and the example plant are served together, and a client talks to them.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from libmodbus_py import Client, Fault, ModbusError, Server, device_file
from libmodbus_py.page import live_page
from tests.support.peers import until
from tests.tools.page.browsers import missing, person_at

ROOT = Path(__file__).resolve().parents[1]

WIDTH, HEIGHT = 1200, 700
MOST_BYTES = 120_000
EXAMPLES = ROOT / "examples"
# The meter of the examples has no faults of its own.
FAULTS = [
    Fault("disconnect", table="input_registers", address=0, count=1, length=5, every=5),
    Fault("garbage", data=b"\0\xff", place="behind", probability=0.01),
]


def main() -> int:
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "page.png"
    if lacking := missing():
        print(f"screenshot: {lacking}", file=sys.stderr)
        return 1
    meter = device_file.load(EXAMPLES / "meter.toml")
    plant = device_file.load(EXAMPLES / "plant.toml")
    server = Server({7: meter.devices, **plant.devices}, faults={**plant.faults, 7: FAULTS})
    is_over = threading.Event()
    with (
        live_page(server) as page,
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=7) as plc,
        person_at(f"{page.url}#7/points", WIDTH, HEIGHT) as person,
    ):
        client = threading.Thread(target=talk, args=(plc, is_over.wait))
        client.start()
        until(lambda: person.run("return document.querySelector('#log').children.length > 30"))
        file.write_bytes(person.driver.get_screenshot_as_png())
        is_over.set()
        client.join()
    size = file.stat().st_size
    print(f"{file}: {size} bytes")
    return 0 if size < MOST_BYTES else 1


def talk(plc: Any, wait: Callable[[float], bool]) -> None:
    """Read and write, and now and then read a missing register, on a line with faults."""
    boiler = plc.for_unit(1)
    requests: list[Callable[[int], object]] = [
        lambda number: plc.read_input_registers(0, 7),
        lambda number: boiler.write_registers(100, [number % 1000, 17, 100]),
        lambda number: boiler.read_input_registers(0, 4),
        lambda number: plc.write_register(0, 2300 + number % 200),
        lambda number: boiler.read_coils(60, 1),
    ]
    for number in range(10_000):
        with suppress(ModbusError):
            requests[number % len(requests)](number)
        if wait(0.1):
            return


if __name__ == "__main__":
    sys.exit(main())
