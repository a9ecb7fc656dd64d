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
from contextlib import ExitStack
from typing import Any

from ..binding.library import loaded_version
from ..client.blocking import Client
from ..device.device import Device
from ..device.mapping import Mapping
from ..ports.endpoint import parse
from ..protocol import pdu
from ..protocol.errors import ExceptionResponse
from ..server.server import Server
from ..tools.testing.wires import SerialWire, TcpWire
from .output import PROGRAM, styled
from .parser import Parser

BOLD, RED, GREEN = "1", "31", "32"

EXAMPLES: tuple[tuple[str, int, pdu.Request[Any], Any], ...] = (
    (
        "read registers 40123-40125 of unit 6",
        6,
        pdu.ReadHoldingRegisters(122, 3),
        [789, 12345, -567 & 0xFFFF],
    ),
    (
        "read coils 20-32 of unit 17",
        17,
        pdu.ReadCoils(19, 13),
        [bool(0x17D3 >> bit & 1) for bit in range(13)],
    ),
    (
        "read file 4, records 1-2, and file 3, records 9-10, of unit 17",
        17,
        pdu.ReadFileRecords(((4, 1, 2), (3, 9, 2))),
        [[0x0DFE, 0x0020], [0x33CD, 0x0040]],
    ),
    (
        "write 999 to register 42450 of unit 13, whose last register is 42048",
        13,
        pdu.WriteRegister(2449, 999),
        "refused: illegal data address (exception 2)",
    ),
)
"""A title, the unit, the request, and the values of the answer, or the refusal."""

NEXT = """
To try next, the second and the third in another terminal:
  {program} serve 127.0.0.1:1502 --example meter
  {program} read 127.0.0.1:1502 --map meter
  {program} identify 127.0.0.1:1502"""


def add_command(command: Parser) -> None:
    command.set_defaults(run=_demo)


def _demo(_: argparse.Namespace) -> int:
    """Run every example on every line; return 0 if all responses are as expected, otherwise 1."""
    version = ".".join(map(str, loaded_version()))
    print(f"libmodbus {version}: a client and a server with a register mapping, on three lines")
    right = True
    for line in ("TCP", "RTU", "ASCII"):
        with ExitStack() as stack:
            url, context, wire = _opened(line, stack)
            print(f"\n{styled(f'{line:<6}', BOLD)} {url}")
            for title, unit, request, expected in EXAMPLES:
                print(f"\n  {styled(title, BOLD)}")
                right &= _show(line, context.for_unit(unit), request, expected, wire)
    print(f"\n{'all answers are right' if right else 'WRONG ANSWERS: see above'}")
    python = f"{shlex.quote(sys.executable)} -m libmodbus_py"
    print(NEXT.format(program=PROGRAM if shutil.which(PROGRAM) else python))
    return 0 if right else 1


def _opened(line: str, stack: ExitStack) -> tuple[str, Client, Any]:
    """Return the URL of a server on a line, a client, and the recorded wire between them."""
    meter, station = Mapping(holding_registers=200), Mapping(coils=100)
    meter.holding_registers[122:125] = EXAMPLES[0][3]
    station.coils[19:32] = EXAMPLES[1][3]
    files = {4: {1: 0x0DFE, 2: 0x0020}, 3: {9: 0x33CD, 10: 0x0040}}
    drive = Device(Mapping(holding_registers=2048))
    server = Server({6: Device(meter), 17: Device(station, files=files), 13: drive})
    if line == "TCP":
        running = stack.enter_context(server.background("tcp://127.0.0.1:0"))
        tcp = stack.enter_context(TcpWire(parse(running.urls[0]).port))
        context = Client(f"tcp://127.0.0.1:{tcp.port}")
        return running.urls[0], stack.enter_context(context), tcp
    wire = stack.enter_context(SerialWire())
    url = f"{line.lower()}://{wire.server}?baudrate=19200"
    running = stack.enter_context(server.background(url))
    context = Client(f"{line.lower()}://{wire.client}?baudrate=19200")
    return running.urls[0], stack.enter_context(context), wire


def _show(line: str, context: Client, request: pdu.Request[Any], expected: Any, wire: Any) -> bool:
    """Send a request, print what is on the line, and return True if the answer is right."""
    wire.clear()
    try:
        answer = context.execute(request)
    except ExceptionResponse as refusal:
        answer = f"refused: {refusal.args[0]}"
    right: bool = answer == expected
    _print_row("function", str(request.function))
    for name, sender in (("request", "client"), ("response", "server")):
        data = wire.sent_by(sender)
        text = repr(data.decode())[1:-1] if line == "ASCII" else data.hex(" ").upper()
        _print_row(name, text)
    answer_text = str(answer) if right else f"{answer} (WRONG)"
    _print_row("answer", styled(answer_text, GREEN if right else RED))
    return right


def _print_row(name: str, text: str) -> None:
    first, *rest = textwrap.wrap(text, 66) if len(text) > 66 else [text]
    print(f"    {name:<9} {first}")
    for more in rest:
        print(f"{'':14}{more}")
