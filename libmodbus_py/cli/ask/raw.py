"""
The command raw: any function code, its data and its response in hexadecimal.
"""

from __future__ import annotations

import argparse
import re
from contextlib import closing
from typing import Any

from .. import arguments

__all__ = ["add_command"]

EXAMPLES = """\
examples:
  libmodbus-py raw 192.0.2.10 03 00 64 00 02
  libmodbus-py raw 192.0.2.10 0x2B "0E 01 00" -v
  libmodbus-py raw /dev/ttyUSB0 -b 9600 -u 7 43 0D0102
  libmodbus-py raw 'tcp://192.0.2.10?unit=7&timeout=0.5' 100"""


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    command = commands.add_parser(
        "raw",
        description="Send a function code and its data as they are. The response is printed in\n"
        "hexadecimal, and decoded if the function is known.",
        epilog=f"{EXAMPLES}\n\n{arguments.URLS}",
    )
    arguments.add_client(command)
    command.add_argument(
        "function", metavar="FUNCTION", help="function code, 1..127, or 03 before single bytes"
    )
    command.add_argument(
        "data", metavar="HEX", nargs="*", help="data after the function code, in hexadecimal"
    )
    command.set_defaults(run=_raw)


def _raw(options: argparse.Namespace) -> int:
    from ...protocol.pdu import RawRequest
    from ...protocol.spelling import number_of
    from ..connecting import connected

    function = options.function
    words = [function, *options.data]
    if all(re.fullmatch("[0-9A-Fa-f]{2}", word) for word in words) and len(words) > 1:
        function = _function_of(function)
    request = RawRequest(number_of("function", function), b"".join(map(_bytes_of, options.data)))
    with closing(connected(options)) as context:
        response = request.encode_response(context.execute(request))
    print(response.hex(" "))
    if (text := _decoded(request.encode(), response)) is not None:
        print(text)
    return 0


def _function_of(byte: str) -> str:
    """Return a function code that stands before bytes as in manuals, such as 03 in 03 00 64."""
    if not re.fullmatch("[1-9][0-9]", byte):
        return f"0x{byte}"
    decimal = f"0x{int(byte):02x}"
    raise ValueError(f"FUNCTION {byte} can be 0x{byte} or {decimal}; type the one that is meant")


def _bytes_of(word: str) -> bytes:
    """Return the bytes of one word, such as 000a, "00 0a", 0x00,0x0a or 00:0a."""
    data = b""
    for part in re.split("[ ,:]+", word.strip(" ,")):
        digits = part[2:] if part[:2] in ("0x", "0X") else part
        if not re.fullmatch("(?:[0-9A-Fa-f]{2})+", digits):
            raise ValueError(f"HEX must be pairs of hex digits, not {part!r}{_hint(digits)}")
        data += bytes.fromhex(digits)
    return data


def _hint(digits: str) -> str:
    """Return a hint for half a byte: a number must be typed with both bytes of its field."""
    if not re.fullmatch("[0-9A-Fa-f]+", digits):
        return ""
    try:
        number = int(digits)
    except ValueError:
        return f"; a byte has two digits, such as {digits[-1:]:>02}"
    return f"; the number {number} of 16 bits is {number & 0xFFFF:04x}"


def _decoded(request: bytes, response: bytes) -> str | None:
    from ...protocol.errors import ModbusError
    from ...protocol.pdu import decode_request

    try:
        known = decode_request(request)
        return f"{known}: {known.decode_response(response)!r}"
    except (ModbusError, ValueError):
        return None
