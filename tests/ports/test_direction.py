"""
RS-485 transceivers that a function or a GPIO line switches: when they are switched, and what
becomes of errors.
"""

from __future__ import annotations

import asyncio
import errno
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from enum import Enum
from types import ModuleType
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Server,
)
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.server import serial as serial_server
from libmodbus_py.testing import SerialWire
from tests.support.driver import rtu
from tests.support.golden import Refused
from tests.support.peers import LinePeer, until
from tests.support.signals import in_child

ANSWERS = {3: rtu("01 03 02 022B"), 4: rtu("01 04 02 022B")}
SENT = "frame"


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The calls of a transceiver, True or False, with the frames that the port sends between."""
    events: list[object] = []
    write = SerialPort._write

    def note(port: SerialPort, data: bytes) -> None:
        events.append(SENT)
        write(port, data)

    monkeypatch.setattr(SerialPort, "_write", note)
    return events


@pytest.fixture
def unit() -> Iterator[LinePeer]:
    """Answers once the frame has left and the transceiver receives, as on a real line."""
    with LinePeer(lambda request, write: write(ANSWERS[request[1]], after=0.1)) as unit:
        yield unit


def failing(events: list[object], *numbers: int, error: type[BaseException] = LookupError) -> Any:
    """Return a function that notes its calls; some of them fail, the first being number 0."""
    calls = iter(range(10_000))

    def turn(is_sending: bool) -> None:
        events.append(is_sending)
        if next(calls) in numbers:
            raise error("no line 17")

    return turn


def test_a_function_is_called_before_and_after_each_frame(events: list[object], unit: LinePeer):
    with Client(f"rtu://{unit.path}", rs485=events.append, rts_delay=0.001) as plc:
        assert events == [False]
        for _ in range(2):
            assert plc.read_holding_registers(0, 1) == [555]
        assert events == [False, True, SENT, False, True, SENT, False]
    assert len(events) == 7


def test_an_asyncio_client_calls_a_function_and_raises_its_error(
    events: list[object], unit: LinePeer
) -> None:
    async def use() -> None:
        url, turn = f"rtu://{unit.path}", failing(events, 3)
        async with AsyncClient(url, rs485=turn, rts_delay=0.001) as plc:
            assert await plc.read_holding_registers(0, 1) == [555]
            with pytest.raises(ModbusConnectionError, match="rs485: LookupError"):
                await plc.read_holding_registers(0, 1)
            assert await plc.read_input_registers(0, 1) == [555]

    asyncio.run(use())
    steps = [True, SENT, False]
    assert events == [False, *steps, True, False, False, *steps]


def test_a_function_is_called_with_the_delays_of_rts(events: list[object]) -> None:
    """A character has 11 bits, and the delays are 20 ms each."""
    with SerialWire() as wire:
        port = SerialPort(wire.client, baudrate=1200, rs485=events.append, rts_delay=0.02)
        port.open()
        port.send([b"12345678"], 100.0)
        assert port.resume_at == pytest.approx(100.02)
        assert events == [False, True]
        port.go_on(100.02)
        assert port.resume_at == pytest.approx(100.04 + 8 * 11 / 1200)
        assert events == [False, True, SENT]
        port.go_on(101.0)
        assert (port.resume_at, events) == (None, [False, True, SENT, False])
        port.close()


@pytest.mark.parametrize(
    ("numbers", "calls"),
    [
        ([0], [False]),  # opening the port
        ([1], [False, True, False]),
        ([2], [False, True, SENT, False, False]),
        ([1, 2], [False, True, False]),  # no attempt is left
    ],
)
def test_what_a_function_raises_fails_its_request_and_the_line_receives(
    numbers, calls, events: list[object], unit: LinePeer, caplog
) -> None:
    """The second number is that of the call which the port makes when it is closed."""
    turn = failing(events, *numbers)
    with closing(Client(f"rtu://{unit.path}", rs485=turn)) as plc:
        with pytest.raises(ModbusConnectionError, match="rs485: LookupError") as caught:
            plc.read_holding_registers(0, 1)
        assert isinstance(caught.value.__cause__, LookupError)
        assert events == calls
        assert caplog.text.count("the RS-485 transceiver may still send") == (2 in numbers)
        events.clear()
        again = plc.for_unit(1, retries=2)  # the answer to the first may still come
        assert again.read_input_registers(0, 1) == [555]
        assert events[:4] == [False, True, SENT, False]


def test_an_interrupted_function_leaves_the_line_receiving(events: list[object], unit: LinePeer):
    turn = failing(events, 1, 5, error=KeyboardInterrupt)
    with Client(f"rtu://{unit.path}", rs485=turn, timeout=10) as plc:
        for calls in ([False, True, False], [False, True, SENT, False, False]):
            with pytest.raises(KeyboardInterrupt):
                plc.read_holding_registers(0, 1)
            assert events == calls
            events.clear()
        # Another function, because an answer to the first request may still come.
        assert plc.read_input_registers(0, 1) == [555]


def test_a_port_that_is_closed_while_it_sends_is_switched_to_receiving(events: list[object]):
    with SerialWire() as wire:
        port = SerialPort(wire.client, rs485=events.append)
        port.open()
        port.send([b"x"], time.monotonic())
        port.close()
        port.close()
    assert events == [False, True, False]


def test_a_forked_child_leaves_the_transceiver_to_its_parent(events: list[object]) -> None:
    with SerialWire() as wire:
        port = SerialPort(wire.client, rs485=events.append)
        port.open()
        port.send([b"x"], time.monotonic())

        def use() -> None:
            port.close()
            assert events == [False, True]

        assert in_child(use) == 0
        port.close()
    assert events == [False, True, False]


def test_wrong_values_of_rs485_are_refused(refused: Refused) -> None:
    refused("wrong_rs485.txt", lambda rs485: SerialPort("/dev/ttyUSB0", rs485=rs485))


def test_a_coroutine_function_is_refused_for_direction(events: list[object]) -> None:
    async def turn(is_sending: bool) -> None:
        events.append(is_sending)

    with pytest.raises(TypeError, match="nothing awaits async def"):
        Client("rtu:///dev/ttyUSB0", rs485=turn)


def test_no_url_contains_a_function(events: list[object]) -> None:
    plc = Client("rtu:///dev/ttyUSB0", rs485=events.append, baudrate=9600)
    assert plc.url == "rtu:///dev/ttyUSB0?baudrate=9600"
    plc.close()


class Value(Enum):
    INACTIVE = 0
    ACTIVE = 1


class Gpiod:
    """What is used of version 2 of libgpiod's package."""

    def __init__(self) -> None:
        self.events: list[object] = []
        self.error: Exception | None = None

    def request_lines(self, path: str, config: dict[Any, Any], consumer: str) -> Gpiod:
        ((line, settings),) = config.items()
        self.events.append((path, line, settings["direction"].name, settings["output_value"]))
        if self.error is not None:
            raise self.error
        return self

    def set_value(self, line: int | str, value: Value) -> None:
        self.events.append((line, value))
        if self.error is not None:
            raise self.error

    def release(self) -> None:
        self.events.append("released")


@pytest.fixture
def gpiod(monkeypatch: pytest.MonkeyPatch) -> Gpiod:
    chip = Gpiod()
    package, line = ModuleType("gpiod"), ModuleType("gpiod.line")
    vars(package).update(request_lines=chip.request_lines, LineSettings=dict)
    vars(line).update(Value=Value, Direction=Enum("Direction", "INPUT OUTPUT"))
    monkeypatch.setitem(sys.modules, "gpiod", package)
    monkeypatch.setitem(sys.modules, "gpiod.line", line)
    return chip


CYCLE = [(17, Value.ACTIVE), (17, Value.INACTIVE)]


def test_a_gpio_line_is_requested_while_the_port_is_open(gpiod: Gpiod, unit: LinePeer) -> None:
    with Client(f"rtu://{unit.path}?rs485=gpio:/dev/gpiochip0/17") as plc:
        assert plc.read_holding_registers(0, 1) == [555]
        requested = ("/dev/gpiochip0", 17, "OUTPUT", Value.INACTIVE)
        assert gpiod.events == [requested, *CYCLE]
    assert gpiod.events == [requested, *CYCLE, "released"]


def test_a_gpio_line_may_have_a_name(gpiod: Gpiod, unit: LinePeer) -> None:
    with Client(f"rtu://{unit.path}", rs485="gpio:/dev/gpiochip0/DE") as plc:
        assert plc.read_holding_registers(0, 1) == [555]
    assert gpiod.events[1:] == [("DE", Value.ACTIVE), ("DE", Value.INACTIVE), "released"]


@pytest.mark.parametrize(
    ("error", "number"),
    [
        (PermissionError(errno.EPERM, "Not permitted"), errno.EPERM),
        (ValueError("no line"), errno.EIO),
    ],
)
def test_a_gpio_line_in_use_fails_the_request(
    error: Exception, number: int, gpiod: Gpiod, unit: LinePeer
) -> None:
    gpiod.error = error
    with closing(Client(f"rtu://{unit.path}?rs485=gpio:/dev/gpiochip0/17")) as plc:
        with pytest.raises(ModbusConnectionError, match="rs485, /dev/gpiochip0/17") as caught:
            plc.read_holding_registers(0, 1)
        assert caught.value.errno == number
        gpiod.error = None
        assert plc.read_holding_registers(0, 1) == [555]


def test_a_server_has_a_gpio_line_and_opens_its_port_again_after_an_error(
    gpiod: Gpiod, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(serial_server, "REOPEN_AFTER", 0.05)
    device = Device(Mapping(holding_registers=2))
    with (
        SerialWire() as wire,
        Server(device).background(f"rtu://{wire.server}?rs485=gpio:/dev/gpiochip0/17"),
        Client(f"rtu://{wire.client}", timeout=0.5) as plc,
    ):
        assert plc.read_holding_registers(0, 2) == [0, 0]
        until(lambda: gpiod.events[-1] == (17, Value.INACTIVE))
        assert gpiod.events[1:] == CYCLE
        gpiod.error = OSError(errno.ENODEV, "No such device")
        with pytest.raises(ModbusTimeoutError):
            plc.read_holding_registers(0, 2)
        assert "rs485: OSError" in caplog.text
        gpiod.error = None
        until(lambda: "open again" in caplog.text)
        assert plc.read_holding_registers(0, 2) == [0, 0]


def test_without_gpiod_the_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(ImportError, match=r"rs485=gpio:\.\.\. needs gpiod: .*install"):
        Client("rtu:///dev/ttyUSB0?rs485=gpio:/dev/gpiochip0/17")
