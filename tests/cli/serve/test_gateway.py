"""
The command gateway: what it passes on, what it reads again, and what it says.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

import pytest

from libmodbus_py import Context, Device, Mapping, Server
from tests.support.commands import PAGE_TOKEN, Started, page_url
from tests.tools.page.watching import Visitor


@contextlib.contextmanager
def passing_on(*arguments: str, count: int = 1) -> Iterator[tuple[Started, list[str]]]:
    with Started("gateway", *arguments) as process:
        lines = [process.stdout.readline() for _ in range(count)]
        assert all(line.startswith("listening on ") for line in lines)
        yield process, [line.removeprefix("listening on ").rstrip("\n") for line in lines]
        process.terminate()
        assert process.wait() == 0


@pytest.fixture
def behind() -> Iterator[str]:
    device = Device(Mapping(10, 10, 10, 10))
    device.mapping.holding_registers[0] = 555
    with Server(device).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_sharing_a_device_takes_one_command(behind: str) -> None:
    urls = ("tcp://127.0.0.1:0", "udp://127.0.0.1:0", "rtu+tcp://127.0.0.1:0")
    with passing_on(*urls, "--to", f"{behind}?timeout=2", count=3) as (_, found):
        for url in found:
            with Context.from_url(url, unit=1) as context:
                assert context.read_holding_registers(0, 1) == [555]


# --- its page ---------------------------------------------------------------------


def test_the_gateway_is_shown() -> None:
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as behind:
        place = behind.urls[0]
        command = ("gateway", "tcp://127.0.0.1:0", "--to", place, "--page", "127.0.0.1:0")
        with Started(*command, environment=PAGE_TOKEN) as process:
            page, listening = sorted((process.stdout.readline() for _ in range(2)), reverse=True)
            with Visitor(page_url(page)).watching() as visitor:
                assert visitor.seen["head"]["kind"] == "gateway"
                assert visitor.seen["head"]["title"] == "tcp://127.0.0.1:0"
                with Context.from_url(listening.split()[-1], unit=5, timeout=10) as plc:
                    plc.read_holding_registers(0, 2)
                visitor.receive(lambda: visitor.seen["log"])
                visitor.look_at(find="127.0.0.1 function")
                visitor.receive(lambda: visitor.rows("rows"))
                assert visitor.seen["rows"]["0"][:3] == [
                    ["127.0.0.1", "unit 5, 3 read holding registers"],
                    ["client", "", 0],
                    1,
                ]
            process.send_signal(signal.SIGTERM)
            process.wait()
