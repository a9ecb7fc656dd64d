"""
The command demo: a client and a server of this package, on three kinds of lines.

The requests are worked examples of manuals and of the specification. The bytes that are printed
were recorded on the line.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from ..binding.library import loaded_version
from ..client.blocking import AsciiContext, Context, RtuContext, TcpContext
from ..device.device import Device
from ..device.mapping import Mapping
from ..ports.endpoint import parse
from ..protocol import pdu
from ..protocol.errors import ExceptionResponse
from ..protocol.values import parse_reference
from ..tools.faults.server import Server
from ..tools.testing.wires import SerialWire, TcpWire
from .output import PROGRAM, styled

__all__ = ["add_command"]

BOLD, RED, GREEN = "1", "31", "32"


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    commands.add_parser("demo").set_defaults(run=_demo)


@dataclass(frozen=True)
class Example:
    """A request, how its answer is printed, and what must be printed."""

    title: str
    unit: int
    request: pdu.Request[Any]
    show: Callable[[Any], str]
    shown: str


def _signed(values: list[int]) -> str:
    return "  ".join(str(value - 0x10000 if value & 0x8000 else value) for value in values)


def _states(values: list[bool]) -> str:
    return " ".join("on" if value else "off" for value in values)


def _records(pieces: list[list[int]]) -> str:
    return "   ".join(" ".join(f"{value:04X}" for value in piece) for piece in pieces)


EXAMPLES = (
    Example(
        "read registers 40123-40125 of unit 6",
        6,
        pdu.ReadHoldingRegisters(parse_reference("40123").address, 3),
        _signed,
        "789  12345  -567",
    ),
    Example(
        "read coils 20-32 of unit 17",
        17,
        pdu.ReadCoils(parse_reference("00020").address, 13),
        _states,
        "on on off off on off on on on on on off on",
    ),
    Example(
        "read file 4, records 1-2, and file 3, records 9-10, of unit 17",
        17,
        pdu.ReadFileRecords(((4, 1, 2), (3, 9, 2))),
        _records,
        "0DFE 0020   33CD 0040",
    ),
    Example(
        "write 999 to register 42450 of unit 13, whose last register is 42048",
        13,
        pdu.WriteRegister(parse_reference("42450").address, 999),
        str,
        "refused: illegal data address (exception 2)",
    ),
)


def _devices() -> dict[int, Device]:
    meter, station, drive = (
        Mapping(holding_registers=200),
        Mapping(coils=100),
        Mapping(holding_registers=2048),
    )
    meter.holding_registers[122:125] = [789, 12345, -567 & 0xFFFF]
    station.coils[19:32] = [bool(0x17D3 >> bit & 1) for bit in range(13)]
    files = {4: {1: 0x0DFE, 2: 0x0020}, 3: {9: 0x33CD, 10: 0x0040}}
    return {6: Device(meter), 17: Device(station, files=files), 13: Device(drive)}


@contextmanager
def _tcp() -> Iterator[tuple[str, Context, Any]]:
    with ExitStack() as stack:
        running = stack.enter_context(Server(_devices()).background("tcp://127.0.0.1:0"))
        wire = stack.enter_context(TcpWire(parse(running.urls[0]).port))
        context = stack.enter_context(TcpContext("127.0.0.1", wire.port, native=True))
        yield running.urls[0], context, wire


@contextmanager
def _serial(scheme: str, make: Callable[[str], Context]) -> Iterator[tuple[str, Context, Any]]:
    with ExitStack() as stack:
        wire = stack.enter_context(SerialWire())
        running = stack.enter_context(
            Server(_devices()).background(f"{scheme}://{wire.server}?baudrate=19200")
        )
        context = stack.enter_context(make(wire.client))
        yield running.urls[0], context, wire


LINES: dict[str, Callable[[], Any]] = {
    "TCP": _tcp,
    "RTU": lambda: _serial("rtu", lambda device: RtuContext(device, 19200, native=True)),
    "ASCII": lambda: _serial("ascii", lambda device: AsciiContext(device, 19200)),
}


NEXT = """
To try next, the second and the third in another terminal:
  {program} serve 127.0.0.1:1502 --example meter
  {program} read 127.0.0.1:1502 --map meter
  {program} identify 127.0.0.1:1502"""


def _program() -> str:
    """Return how the command line is called: by its name, if a shell finds it."""
    return PROGRAM if shutil.which(PROGRAM) else f"{shlex.quote(sys.executable)} -m libmodbus_py"


def _demo(_: argparse.Namespace) -> int:
    """Run every example on every line; return 0 if all responses are as expected, otherwise 1."""
    version = ".".join(map(str, loaded_version()))
    print(f"libmodbus {version}: a client and a server with a register mapping, on three lines")
    right = True
    for name, line in LINES.items():
        with line() as (url, context, wire):
            print(f"\n{styled(f'{name:<6}', BOLD)} {url}")
            for example in EXAMPLES:
                right &= _show(name, example, context.for_unit(example.unit), wire)
    print(f"\n{'all answers are right' if right else 'WRONG ANSWERS: see above'}")
    print(NEXT.format(program=_program()))
    return 0 if right else 1


def _show(line: str, example: Example, context: Context, wire: Any) -> bool:
    wire.clear()
    try:
        answer = example.show(context.execute(example.request))
    except ExceptionResponse as refusal:
        answer = f"refused: {refusal.args[0]}"
    carrier = "Python" if line == "ASCII" else "C"
    print(f"\n  {styled(example.title, BOLD)}")
    _row("function", f"{example.request.function}, carried by {carrier}")
    _row("request", _wire_text(line, wire.sent_by("client")))
    _row("response", _wire_text(line, wire.sent_by("server")))
    right = answer == example.shown
    _row("answer", styled(answer, GREEN) if right else styled(f"{answer} (WRONG)", RED))
    return right


def _wire_text(line: str, data: bytes) -> str:
    return repr(data.decode())[1:-1] if line == "ASCII" else data.hex(" ").upper()


def _row(name: str, text: str) -> None:
    first, *rest = textwrap.wrap(text, 66) if len(text) > 66 else [text]
    print(f"    {name:<9} {first}")
    for more in rest:
        print(f"{'':14}{more}")
