"""
The commands identify and diagnose, for what a device says of itself, and raw.

identify asks for the device identification and the server id (functions 43/14 and 17), diagnose for
status, counters and events (functions 7, 8, 11 and 12), raw sends any function code.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from .. import arguments
from ..output import print_json
from ..parser import Parser, declare

if TYPE_CHECKING:
    from ...client.blocking import Client
    from .units import Named

IDENTIFY = """\
Print the device identification (function 43/14) and the server id
(function 17). Devices have one, both or neither; with neither the exit code
is 1."""

OF_IDENTIFY = """\
examples:
  libmodbus-py identify 192.0.2.10
  libmodbus-py identify /dev/ttyUSB0 -b 9600 -u 1-9,17
  libmodbus-py identify 192.0.2.10 --level extended --json
  libmodbus-py identify 'tcp://192.0.2.10?unit=7&timeout=0.5' --level 4"""

OF_DIAGNOSE = """\
examples:
  libmodbus-py diagnose /dev/ttyUSB0 -b 9600 -u 7
  libmodbus-py diagnose 192.0.2.10 return-query-data 0x1234
  libmodbus-py diagnose 192.0.2.10 clear-counters -u 1-9
  libmodbus-py diagnose 'rtu:///dev/ttyUSB0?baudrate=9600&unit=7' 11"""

OF_RAW = """\
examples:
  libmodbus-py raw 192.0.2.10 03 00 64 00 02
  libmodbus-py raw 192.0.2.10 0x2B "0E 01 00" -v
  libmodbus-py raw /dev/ttyUSB0 -b 9600 -u 7 43 0D0102
  libmodbus-py raw 'tcp://192.0.2.10?unit=7&timeout=0.5' 100"""

LEVEL = "--level L\n  basic, regular, extended, or the number of one object (regular)"

DIAGNOSE = """\
Print the exception status (function 7), the counters (8), the event
counter (11) and the event log (12), as far as the device has them. Nothing in
the device changes, unless SUB-FUNCTION is given and changes something."""

SUB_FUNCTION = """
[SUB-FUNCTION]
    sub-function of function 8, by name or number, such as clear-counters or 10
[DATA]
    data of the sub-function, 0..65535 (0)
"""

RAW = """\
Send a function code and its data as they are. The response is printed in
hexadecimal, and decoded if the function is known."""

FUNCTION = """
FUNCTION
    function code, 1..127, or 03 before single bytes
[HEX ...]
    data after the function code, in hexadecimal
"""


def add_command(command: Parser) -> None:
    name = command.prog.rpartition(" ")[2]
    arguments.add_client(command, several=name != "raw")
    if name == "raw":
        declare(command, FUNCTION, hex={"dest": "data"})
        text, examples, run = RAW, OF_RAW, _raw
    elif name == "diagnose":
        declare(command, SUB_FUNCTION, data={"default": "0"})
        text, examples, run = DIAGNOSE, OF_DIAGNOSE, _diagnose
    else:
        levels = {"default": "regular", "complete": ["basic", "regular", "extended"]}
        declare(command, LEVEL, level=levels)
        text, examples, run = IDENTIFY, OF_IDENTIFY, _identify
    if name != "raw":
        arguments.add_forms(command)
    command.description, command.epilog = text, f"{examples}\n\n{arguments.URLS}"
    command.set_defaults(run=run)


def _identify(options: argparse.Namespace) -> int:
    from ...protocol.errors import ModbusError
    from ...protocol.pdu.interface import MANDATORY, OBJECT_NAMES
    from ...protocol.plain import number_of
    from .units import report_units

    level = options.level
    category: Any = number_of("level", level) if level[:1].isdigit() else level

    def identification(context: Client) -> Named:
        objects = context.read_device_identification(category).objects
        if category in ("regular", "extended") and MANDATORY - objects.keys():
            with suppress(ModbusError):  # some devices leave out what the basic level has
                objects = {**context.read_device_identification("basic").objects, **objects}
        return [(OBJECT_NAMES.get(at, f"object {at}"), objects[at]) for at in sorted(objects)]

    def server_id(context: Client) -> Named:
        report = context.report_server_id()
        is_told = report.running is not None
        return [("server id", report.data), *[("running", report.running)] * is_told]

    return report_units(options, {"identification": identification, "server id": server_id})


# --- diagnose ------------------------------------------------------------------------


def _diagnose(options: argparse.Namespace) -> int:
    from ...protocol.plain import number_of
    from .units import ask_units, fail, report_units, units_of

    if options.sub_function is None:
        return report_units(options, _questions())
    sub, data = _sub_function(options.sub_function), number_of("data", options.data)
    several = len(units_of(options)) > 1

    def ask(client: Client) -> None:
        answer = _answer(client, sub, data)
        if options.json:
            print_json({"unit": client.unit, _name(sub): answer})
        else:
            print(f"unit {client.unit}: {answer}" if several else answer, flush=True)

    return ask_units(options, ask, partial(fail, as_json=options.json, lacks="answer"))


def _answer(context: Client, sub: int, data: int) -> int:
    """Return the data of the answer, or `data` if a device that shall listen only is silent."""
    from ...protocol.errors import ModbusTimeoutError
    from ...protocol.pdu import RawRequest, SubFunction

    if sub != SubFunction.FORCE_LISTEN_ONLY:
        return context.diagnostics(sub, data)
    # The method of the client would not wait for a refusal: the specification has no answer here.
    request = RawRequest(8, sub.to_bytes(2, "big") + data.to_bytes(2, "big"))
    with suppress(ModbusTimeoutError):
        context.execute(request)
    return data


def _questions() -> dict[str, Callable[[Client], Named]]:
    """Return the requests that change nothing in the device."""
    from ...protocol.pdu import SubFunction

    def status(context: Client) -> Named:
        return [("exception status", f"{context.read_exception_status():08b}")]

    def counter(sub: int, context: Client) -> Named:
        return [(_name(sub), context.diagnostics(sub))]

    counters = range(SubFunction.BUS_MESSAGE_COUNT, SubFunction.BUS_CHARACTER_OVERRUN_COUNT + 1)
    subs = [SubFunction.RETURN_DIAGNOSTIC_REGISTER, *counters]
    return {
        "exception status": status,
        "event counter": lambda context: context.read_comm_event_counter()._asdict().items(),
        "event log": lambda context: context.read_comm_event_log()._asdict().items(),
        **{_name(sub): partial(counter, sub) for sub in subs},
    }


def _sub_function(text: str) -> int:
    from ...protocol.pdu import SubFunction
    from ...protocol.plain import number_of

    names = {_name(sub): int(sub) for sub in SubFunction}
    name = text.lower().replace("-", " ").replace("_", " ")
    if name in names:
        return names[name]
    try:
        return number_of("sub-function", text)
    except ValueError:
        words = ", ".join(word.replace(" ", "-") for word in names)
        raise ValueError(f"SUB-FUNCTION must be a number or one of {words}, not {text!r}") from None


def _name(sub: int) -> str:
    from ...protocol.pdu import SubFunction

    try:
        return SubFunction(sub).name.lower().replace("_", " ")
    except ValueError:
        return f"sub-function {sub}"


# --- raw -----------------------------------------------------------------------------


def _raw(options: argparse.Namespace) -> int:
    from ...protocol.errors import ModbusError
    from ...protocol.pdu import RawRequest, decode_request
    from ...protocol.plain import number_of
    from ..arguments import new_client

    function = options.function
    words = [function, *options.data]
    if len(words) > 1 and all(re.fullmatch("[0-9A-Fa-f]{2}", word) for word in words):
        # As in manuals: 03 00 64.
        if re.fullmatch("[1-9][0-9]", function):
            ways = f"0x{function} or 0x{int(function):02x}"
            raise ValueError(f"FUNCTION {function} can be {ways}; type the one that is meant")
        function = f"0x{function}"
    request = RawRequest(number_of("function", function), b"".join(map(_bytes_of, options.data)))
    with closing(new_client(options)) as context:
        response = request.encode_response(context.execute(request))
    print(response.hex(" "))
    with suppress(ModbusError, ValueError):  # of an unknown function
        request_of_class = decode_request(request.encode())
        print(f"{request_of_class}: {request_of_class.decode_response(response)!r}")
    return 0


def _bytes_of(word: str) -> bytes:
    """Return the bytes of one word, such as 000a, "00 0a", 0x00,0x0a or 00:0a."""
    data = b""
    for part in re.split("[ ,:]+", word.strip(" ,")):
        digits = part[2:] if part[:2] in ("0x", "0X") else part
        if not re.fullmatch("(?:[0-9A-Fa-f]{2})+", digits):
            raise ValueError(f"HEX must be pairs of hex digits, not {part!r}")
        data += bytes.fromhex(digits)
    return data
