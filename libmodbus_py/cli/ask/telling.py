"""
What a device says of itself: identification, diagnostics, and the answer to any function.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable
from contextlib import closing
from typing import Any

from ...client.blocking import Context
from ...protocol import pdu
from ...protocol.errors import ExceptionResponse, InvalidResponse, ModbusError
from ...protocol.pdu import SubFunction
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.spelling import number_of
from ..connecting import connected
from ..failing import CommandError

__all__ = ["diagnose", "identify", "raw"]

Row = tuple[str, Any]


def identify(options: argparse.Namespace) -> int:
    """Print both; whichever the device has."""
    level = options.level
    wanted: str | int = number_of("level", level) if level[:1].isdigit() else level
    with closing(connected(options)) as context:
        asked: dict[str, Callable[[], Iterable[Row]]] = {
            "identification": lambda: _objects(context.read_device_identification(wanted)),
            "server id": lambda: _server_id(context.report_server_id()),
        }
        return _print_all(context, asked, as_json=options.json)


def diagnose(options: argparse.Namespace) -> int:
    """Print all that only reads, or what one sub-function gives."""
    with closing(connected(options)) as context:
        if options.sub_function is not None:
            sub = _sub_function(options.sub_function)
            answer = context.diagnostics(sub, number_of("data", options.data))
            print(json.dumps({_name(sub): answer}) if options.json else answer)
            return 0
        asked: dict[str, Callable[[], Iterable[Row]]] = {
            "exception status": lambda: [("exception status", _bits(context))],
            "event counter": lambda: context.read_comm_event_counter()._asdict().items(),
            "event log": lambda: context.read_comm_event_log()._asdict().items(),
        }
        for sub in COUNTERS:
            asked[_name(sub)] = lambda sub=sub: [(_name(sub), context.diagnostics(sub))]  # type: ignore[misc]
        return _print_all(context, asked, as_json=options.json)


COUNTERS = (
    SubFunction.RETURN_DIAGNOSTIC_REGISTER,
    *(SubFunction(number) for number in range(SubFunction.BUS_MESSAGE_COUNT, 0x13)),
)


def _bits(context: Context) -> str:
    return f"{context.read_exception_status():08b}"


def _sub_function(text: str) -> int:
    names = {_name(sub): int(sub) for sub in SubFunction}
    name = text.lower().replace("-", " ").replace("_", " ")
    if name in names:
        return names[name]
    try:
        return number_of("sub-function", text)
    except ValueError:
        known = ", ".join(each.replace(" ", "-") for each in names)
        raise ValueError(f"SUB-FUNCTION must be a number or one of {known}, not {text!r}") from None


def _name(sub: int) -> str:
    try:
        return SubFunction(sub).name.lower().replace("_", " ")
    except ValueError:
        return f"sub-function {sub}"


# --- what several functions say -------------------------------------------------------


def _print_all(
    context: Context, asked: dict[str, Callable[[], Iterable[Row]]], *, as_json: bool
) -> int:
    """Print what comes of each, and which the device lacks; 1 if it has none."""
    told: dict[str, Any] = {}
    lacking: dict[str, str] = {}
    for name, ask in asked.items():
        try:
            told.update(ask())
        except (ExceptionResponse, InvalidResponse) as error:
            lacking[name] = str(error.args[0])
    if as_json:
        plain = {name: _plain(value) for name, value in told.items()}
        print(json.dumps({"unit": context.unit, **plain, "lacking": lacking}))
    else:
        _print_rows(told, lacking)
    if not told:
        raise CommandError(
            f"unit {context.unit} has nothing of this: {'; '.join(lacking.values())}"
        )
    return 0


def _print_rows(told: dict[str, Any], lacking: dict[str, str]) -> None:
    rows = {name: _shown(value) for name, value in told.items()}
    if told:
        rows |= {name: f"({reason})" for name, reason in lacking.items()}
    width = max(map(len, rows), default=0)
    for name, text in rows.items():
        print(f"{name.replace('_', ' '):<{width}}  {text}")


def _objects(found: pdu.DeviceIdentification) -> Iterable[Row]:
    for number, value in sorted(found.objects.items()):
        yield OBJECT_NAMES.get(number, f"object {number}"), value


def _server_id(found: pdu.ServerId) -> Iterable[Row]:
    yield "server id", found.data
    yield "running", found.running


def _shown(value: Any) -> str:
    """Nothing that a terminal would obey."""
    if isinstance(value, bytes):
        is_text = value and all(0x20 <= byte < 0x7F for byte in value)
        return value.decode() if is_text else value.hex(" ")
    return str(value)


def _plain(value: Any) -> Any:
    return _shown(value) if isinstance(value, bytes) else value


# --- any function ------------------------------------------------------------------------


def raw(options: argparse.Namespace) -> int:
    """Send it; the response in hex, and in words where the function is known."""
    function = number_of("function", options.function)
    try:
        data = bytes.fromhex("".join(options.data))
    except ValueError:
        typed = " ".join(options.data)
        raise ValueError(f"HEX must be pairs of hex digits, not {typed!r}") from None
    request = pdu.RawRequest(function, data)
    with closing(connected(options)) as context:
        response = request.encode_response(context.execute(request))
    print(response.hex(" "))
    if (told := _meaning(request.encode(), response)) is not None:
        print(told)
    return 0


def _meaning(request: bytes, response: bytes) -> str | None:
    try:
        known = pdu.decode_request(request)
        return f"{known}: {known.decode_response(response)!r}"
    except (ModbusError, ValueError):
        return None
