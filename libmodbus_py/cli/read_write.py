"""
The commands read and write: one request, and what it gave.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import re
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from ..client.blocking import Context
from ..protocol import pdu, tables
from ..protocol.values import (
    ORDERS,
    TYPES,
    Reading,
    ValueType,
    parse_reference,
    readings,
    value_type,
)
from . import security

__all__ = ["UndecodableError", "add_commands"]

TABLES = {
    "coils": "coils",
    "discrete": "discrete_inputs",
    "holding": "holding_registers",
    "input": "input_registers",
    "file": "file",
}
"""What is typed -> the table's name."""

# Sections 6.3, 6.4, 6.12, 6.14 and 6.15.
REGISTERS = {
    name: (rules.most_read, rules.most_written)
    for name, rules in tables.TABLES.items()
    if not rules.is_bits
} | {"file": (124, 122)}
"""Table of registers -> how many of them one request reads, and writes."""

BITS = {"0": False, "1": True, "off": False, "on": True, "false": False, "true": True}


class UndecodableError(Exception):
    """The device answered, but what it has is no value of the type asked for."""


class Place(NamedTuple):
    """A run of items: the table, its first address, and the words that followed."""

    table: str
    file: int
    address: int
    rest: list[str]


def add_commands(commands: Any) -> None:
    """Tell argparse of both."""
    where = "TABLE ADDRESS (coils, discrete, holding, input, file:N; from 0) or a reference (40123)"
    command = commands.add_parser("read", help="read a table", description=f"WHERE: {where}")
    _add_client_arguments(command)
    _add_type_arguments(command, ", or all: every reading of COUNT registers")
    command.add_argument("where", metavar="WHERE", nargs="+", help="where, and how many (1)")
    command.add_argument("--json", action="store_true", help="print one line of JSON")
    command.set_defaults(run=_read)

    command = commands.add_parser(
        "write",
        help="write a table",
        description=f"WHERE: {where}",
        epilog="text that begins with - goes after --, and the options before it",
    )
    _add_client_arguments(command)
    _add_type_arguments(command, "")
    command.add_argument("where", metavar="WHERE VALUE", nargs="+", help="where, and the values")
    command.set_defaults(run=_write)


def _add_client_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "url", metavar="URL", help="such as tcp://192.0.2.10 or rtu:///dev/ttyUSB0"
    )
    command.add_argument("--unit", type=int, metavar="N", help="0..255 (that of the URL, or 1)")
    command.add_argument("--timeout", type=float, metavar="S", help="seconds (of the URL, or 1)")
    command.add_argument("-v", "--verbose", action="store_true", help="show frames on stderr")
    security.add_arguments(command)


def _add_type_arguments(command: argparse.ArgumentParser, more: str) -> None:
    command.add_argument(
        "--type", metavar="T", help=f"of values: {', '.join(TYPES)}, string:N{more}"
    )
    command.add_argument("--order", metavar="O", help=f"of their bytes: {', '.join(ORDERS)} (ABCD)")


def _place(words: list[str]) -> Place:
    """Read ``TABLE ADDRESS REST...`` or ``REFERENCE REST...``."""
    first, *rest = words
    name, _, file = first.partition(":")
    if name not in TABLES:
        if not first.isdigit():
            raise ValueError(f"{first!r} must be one of {', '.join(TABLES)}, or such as 40123")
        table, address = parse_reference(first)
        if table == "file":
            raise ValueError(f"{first!r} lacks the file's number: write file:N {address}")
        return Place(table, 0, address, rest)
    if (name == "file") != bool(file):
        raise ValueError(f"{first!r}: a file, and only a file, has a number, as in file:4")
    if not rest:
        raise ValueError(f"{first} lacks an address")
    number = _number("file", file) if file else 0
    return Place(TABLES[name], number, _number("address", rest[0]), rest[1:])


def _number(name: str, text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise ValueError(f"{name} must be a number, not {text!r}") from None


def _context(options: argparse.Namespace) -> Context:
    """What is told by an option overrides the URL."""
    if options.verbose:
        logger = logging.getLogger("libmodbus_py.wire")
        logger.setLevel(logging.DEBUG)
        logger.addHandler(logging.StreamHandler())
    told = {
        "unit": options.unit,
        "timeout": options.timeout,
        "security": security.told(options),
    }
    given: Any = {name: value for name, value in told.items() if value is not None}
    return Context.from_url(options.url, **given)


# --- types ---------------------------------------------------------------------------


def _is_typed(options: argparse.Namespace) -> bool:
    return options.type is not None or options.order is not None


def _value_type(options: argparse.Namespace, place: Place) -> ValueType:
    if options.type is None:
        raise ValueError("--order needs --type, for it is of a value's bytes")
    _check_has_registers(place)
    return value_type(options.type, order=options.order or "ABCD")


def _check_has_registers(place: Place) -> None:
    if place.table not in REGISTERS:
        allowed = ", ".join(name for name, table in TABLES.items() if table in REGISTERS)
        raise ValueError(f"{place.table.replace('_', ' ')} have no --type, only {allowed} have")


def _check_fits(kind: ValueType, name: str, count: int, limit: int) -> None:
    """Say it in values, for a request's own error would say it in registers."""
    most = limit // kind.registers
    if not most:
        raise ValueError(f"{kind.name} takes {kind.registers} registers, and a request {limit}")
    if not 1 <= count <= most:
        raise ValueError(f"{name} of {kind.name} must be in 1..{most}, not {count}")


def _family(kind: ValueType) -> str:
    return kind.name.rstrip("0123456789")


# --- read ----------------------------------------------------------------------------


class _Plain:
    """
    Items as they are: registers as numbers, bits as 0 and 1.

    The base of what `read` prints: how many registers it needs, a line for
    each item, and the fields of JSON.
    """

    def __init__(self, options: argparse.Namespace, place: Place) -> None:
        self.place = place

    def count(self, given: int) -> int:
        """How many items to ask the device for."""
        return given

    def fields(self, items: list[int]) -> dict[str, Any]:
        return {"values": items}

    def lines(self, items: list[int]) -> Iterable[str]:
        return self._numbered([str(item) for item in items], step=1)

    def _numbered(self, texts: list[str], step: int, align: str = ">") -> Iterable[str]:
        width = max(map(len, texts)) if align == ">" else 0
        for at, text in enumerate(texts):
            yield f"{self.place.address + at * step:>5}  {text:>{width}}"


class _Typed(_Plain):
    """Values of a type; each line has the address of the first register."""

    def __init__(self, options: argparse.Namespace, place: Place) -> None:
        super().__init__(options, place)
        self.kind = _value_type(options, place)

    def count(self, given: int) -> int:
        _check_fits(self.kind, "count", given, REGISTERS[self.place.table][0])
        return given * self.kind.registers

    def _values(self, items: list[int]) -> list[Any]:
        try:
            return self.kind.decode_many(items)
        except ValueError as error:
            place = f"{self.place.table.replace('_', ' ')} from {self.place.address}"
            raise UndecodableError(f"{place}: {error}") from None

    def fields(self, items: list[int]) -> dict[str, Any]:
        values = [_as_json(value) for value in self._values(items)]
        return {"type": self.kind.name, "order": self.kind.order, "values": values}

    def lines(self, items: list[int]) -> Iterable[str]:
        texts = [_shown(value, self.kind) for value in self._values(items)]
        return self._numbered(texts, self.kind.registers, "<" if self.kind.is_text else ">")


class _Readings(_Plain):
    """Every reading of the registers as one value."""

    def __init__(self, options: argparse.Namespace, place: Place) -> None:
        super().__init__(options, place)
        _check_has_registers(place)
        if options.order is not None:
            raise ValueError("--type all shows every order, and has no --order")

    def count(self, given: int) -> int:
        limit = REGISTERS[self.place.table][0]
        if not 1 <= given <= limit:
            raise ValueError(f"count must be in 1..{limit}, not {given}")
        return given

    def _readings(self, items: list[int]) -> list[Reading]:
        found = readings(items)
        if not found:
            raise UndecodableError(f"{len(items)} registers can only be text, and these are not")
        return found

    def fields(self, items: list[int]) -> dict[str, Any]:
        found = self._readings(items)
        rows = [{**reading._asdict(), "value": _as_json(reading.value)} for reading in found]
        return {"registers": items, "readings": rows}

    def lines(self, items: list[int]) -> Iterable[str]:
        found = self._readings(items)
        width = max(len(reading.type) for reading in found)
        for name, order, value in found:
            yield f"{name:<{width}}  {order}  {_shown(value, value_type(name))}"


def _read(options: argparse.Namespace) -> int:
    place = _place(options.where)
    if len(place.rest) > 1:
        raise ValueError(f"{' '.join(place.rest[1:])!r} after the count means nothing")
    view = _view(options, place)
    count = view.count(_number("count", place.rest[0]) if place.rest else 1)
    request = _read_request(place, count)
    with _context(options) as context:
        result = context.execute(request)
    items = [int(item) for item in (result[0] if place.table == "file" else result)]
    if options.json:
        print(json.dumps({**_whence(context.unit, place), **view.fields(items)}))
    else:
        print("\n".join(view.lines(items)))
    return 0


def _view(options: argparse.Namespace, place: Place) -> _Plain:
    if options.type == "all":
        return _Readings(options, place)
    return _Typed(options, place) if _is_typed(options) else _Plain(options, place)


def _read_request(place: Place, count: int) -> pdu.Request[Any]:
    if place.table == "file":
        return pdu.ReadFileRecords(((place.file, place.address, count),))
    return tables.TABLES[place.table].read(place.address, count)


def _whence(unit: int, place: Place) -> dict[str, Any]:
    found = {"unit": unit, "table": place.table, "address": place.address}
    return {**found, "file": place.file} if place.table == "file" else found


def _as_json(value: Any) -> Any:
    """As JSON has it: bits as 0 and 1; nan and inf, which JSON lacks, as text."""
    if isinstance(value, list):
        return [int(bit) for bit in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


# From as many digits as every value keeps to as many as tell every two values apart (IEEE 754).
DIGITS = {"float16": range(3, 6), "float32": range(6, 10), "float64": range(15, 18)}


def _shortest(value: float, kind: ValueType) -> str:
    """The shortest number with the same bits: 3.14, not 3.140000104904175."""
    if not math.isfinite(value):  # a nan's sign is in its bits, and in no text
        return str(value)
    numbers = (float(f"{value:.{digits}g}") for digits in DIGITS[kind.name])
    return str(next(number for number in numbers if kind.encode(number) == kind.encode(value)))


def _digits(value: list[bool], kind: ValueType) -> str:
    return "".join(str(int(bit)) for bit in value)


def _quoted(value: str, kind: ValueType) -> str:
    return repr(value)


SHOWN: dict[str, Callable[[Any, ValueType], str]] = {
    "float": _shortest,
    "bits": _digits,
    "string:": _quoted,
}
"""Family of types -> how a value of it is printed; others as numbers."""


def _shown(value: Any, kind: ValueType) -> str:
    show = SHOWN.get(_family(kind))
    return show(value, kind) if show else str(value)


# --- write ---------------------------------------------------------------------------


def _write(options: argparse.Namespace) -> int:
    place = _place(options.where)
    if not place.rest:
        raise ValueError("there is no value to write")
    request = _write_request(options, place)
    with _context(options) as context:
        context.execute(request)
    return 0


def _write_request(options: argparse.Namespace, place: Place) -> pdu.Request[Any]:
    if place.table in ("discrete_inputs", "input_registers"):
        raise ValueError(f"{place.table.replace('_', ' ')} can only be read")
    values = _typed_registers(options, place) if _is_typed(options) else None
    if place.table == "coils":
        bits = tuple(_bit(text) for text in place.rest)
        if len(bits) == 1:
            return pdu.WriteCoil(place.address, bits[0])
        return pdu.WriteCoils(place.address, bits)
    if values is None:
        values = [_register(text) for text in place.rest]
    if place.table == "file":
        return pdu.WriteFileRecords(((place.file, place.address, tuple(values)),))
    if len(values) == 1:
        return pdu.WriteRegister(place.address, values[0])
    return pdu.WriteRegisters(place.address, tuple(values))


def _typed_registers(options: argparse.Namespace, place: Place) -> list[int]:
    kind = _value_type(options, place)
    _check_fits(kind, "the number of values", len(place.rest), REGISTERS[place.table][1])
    parse = PARSERS.get(_family(kind), _integer)
    return kind.encode_many([parse(text) for text in place.rest])


def _integer(text: str) -> int:
    return _number("value", text)


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"value must be a number, inf or nan, not {text!r}") from None


def _bits(text: str) -> list[int]:
    if not re.fullmatch("[01]+", text):
        raise ValueError(f"value must be digits 0 and 1, lowest bit first, not {text!r}")
    return [int(digit) for digit in text]


PARSERS: dict[str, Callable[[str], Any]] = {"float": _float, "bits": _bits, "string:": str}
"""Family of types -> how a value of it is typed; others as numbers."""


def _bit(text: str) -> bool:
    try:
        return BITS[text.lower()]
    except KeyError:
        raise ValueError(f"value must be one of {', '.join(BITS)}, not {text!r}") from None


def _register(text: str) -> int:
    """Signed and unsigned are the same 16 bits."""
    value = _number("value", text)
    if not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"value must be in -32768..65535, not {value}")
    return value & 0xFFFF
