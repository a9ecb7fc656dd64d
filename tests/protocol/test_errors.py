"""Errors, and rows of worked examples."""

import copy
import json
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py.protocol import errors
from libmodbus_py.protocol.errors import (
    ExceptionResponse,
    FrameError,
    IllegalDataAddress,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    alike,
    in_hex,
)
from tests.support.cases import each_case
from tests.support.vector_row import FILE, appended, frame_row
from tests.support.vectors import FRAMES, FrameVector, rows

TOLD: dict[str, Any] = {
    "unit": 17,
    "function": 3,
    "asked": "ReadHoldingRegisters(address=1, count=2)",
    "endpoint": "tcp://192.0.2.10:502",
    "sent": bytes(range(12)),
    "received": b"\x11\x83\x02",
}
KINDS = [getattr(errors, name) for name in errors.__all__]


def test_repr_shows_every_attribute() -> None:
    assert repr(IllegalDataAddress(**TOLD)) == (
        "IllegalDataAddress('illegal data address (exception 2)', code=2, unit=17, function=3,"
        " asked='ReadHoldingRegisters(address=1, count=2)', endpoint='tcp://192.0.2.10:502',"
        " sent=<00 01 02 03 04 05 06 07 08 09 0a 0b>, received=<11 83 02>)"
    )
    assert "errno=111" in repr(ModbusConnectionError("refused", errno=111))
    assert repr(ModbusTimeoutError("no answer")) == "ModbusTimeoutError('no answer')"
    assert repr(FrameError()) == "FrameError('')"


def test_text_is_one_line_without_the_endpoint() -> None:
    text = str(FrameError("a wrong CRC", **TOLD))
    assert text == "unit 17, function 3, ReadHoldingRegisters(address=1, count=2): a wrong CRC"


@each_case("kind", KINDS)
def test_an_unknown_keyword_is_refused_with_the_valid_ones(kind: type[ModbusError]) -> None:
    with pytest.raises(TypeError, match=r"has no argument 'slave'; it has unit, function"):
        kind(slave=17)  # type: ignore[call-arg]


def test_hex_is_cut_and_counted() -> None:
    assert in_hex(bytes(32)) == " ".join(["00"] * 32)
    assert in_hex(bytes(33)) == " ".join(["00"] * 32) + " ... (33 bytes)"
    assert in_hex(b"") == ""
    assert len(repr(FrameError("x", received=bytes(10_000)))) < 200


@each_case("kind", KINDS)
@each_case("reason", [2, 0, True, b"refused", OSError("refused"), None])
def test_a_reason_must_be_text(reason: Any, kind: type[ModbusError]) -> None:
    with pytest.raises(TypeError, match=r"^reason must be a string") as caught:
        kind(reason)
    is_code = issubclass(kind, ExceptionResponse) and isinstance(reason, int)
    assert (f"ExceptionResponse.of({reason})" in str(caught.value)) == is_code


@each_case("kind", KINDS)
def test_errors_keep_the_first_600_bytes_whoever_sets_them(kind: type[ModbusError]) -> None:
    flood = bytes(range(256)) * 300
    error = kind("x", received=flood)
    assert error.received == flood[:600]
    error.received = b"\1" + flood
    assert error.received == b"\1" + flood[:599]
    error.received += flood
    assert len(error.received) == 600
    error.received = b""
    assert error.received == b""


@each_case("kind", KINDS)
@each_case("number", [None, 0, 5])
@each_case(
    "double", [copy.copy, copy.deepcopy, alike, lambda each: pickle.loads(pickle.dumps(each))]
)
def test_copies_keep_every_attribute(kind: Any, number: Any, double: Callable[[Any], Any]) -> None:
    error = kind("x", **TOLD)
    if isinstance(error, OSError) and number is not None:
        error.errno, error.strerror, error.filename, error.filename2 = number, "text", "a", "b"
    assert (repr(double(error)), vars(double(error))) == (repr(error), vars(error))
    for name in ("args", "errno", "strerror", "filename", "filename2", "__suppress_context__"):
        assert getattr(double(error), name, None) == getattr(error, name, None)


def test_a_received_bytearray_is_kept_as_bytes() -> None:
    error = ExceptionResponse.of(2)
    error.received = bytearray(b"\1")
    assert type(error.received) is bytes


@pytest.mark.parametrize("vector", rows(FRAMES))
def test_a_row_has_the_frame_of_the_pdu_in_each_framing(vector: FrameVector) -> None:
    request = vector.request or ("none" if vector.kind == "response" else None)
    row = frame_row(vector.id, vector.place, vector.unit, vector.pdu, {}, request)
    assert bytes.fromhex(row["rtu"]) == vector.rtu
    assert row["ascii"].encode() == vector.ascii
    assert bytes.fromhex(row["tcp"])[2:] == vector.tcp[2:]  # behind the transaction
    assert (row["kind"], row["function"]) == (vector.kind, vector.function)


def test_a_row_is_appended_once() -> None:
    text = FILE.read_text()
    row = frame_row("own-new", "6.5", 1, bytes.fromhex("0500ACFF00"), {"value": "ON"})
    more = appended(text, row)
    assert json.loads(more) == [*json.loads(text), row]
    assert more.startswith(text.rstrip("\n]"))
    with pytest.raises(ValueError, match="there is a row 'own-new'"):
        appended(more, row)
