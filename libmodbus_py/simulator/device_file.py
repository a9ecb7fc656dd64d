"""
Device files: whole simulated devices, written in TOML.

``examples/plant.toml`` of the source tree has every key once, explained. In short::

    [[unit]]                            one or more; without id: any unit
      id, exception_status
      [unit.server_id]                  identifier, running, additional
      [unit.identification]             VendorName = "...", 128 = "..."
      [[unit.coils]]                    ranges, also discrete_inputs, input_registers
      [[unit.holding_registers]]        and holding_registers: address, count, value or
                                        values, type, order, encoding, padding, access;
                                        counter, sine, random_walk or copy
      [[unit.file]]                     records of a file: number, record, count, ...
      [[unit.fifo]]                     address, values
      [[unit.fault]]                    as `faults.Fault`
      [unit.roles.NAME]                 who may read and write what, in place of those below
    [[fault]]                           of all units
    [roles.NAME]                        read, write, functions, as `Allow`; "" without a role

What lies in no range does not exist: it is answered with exception 2, as is what a
range does not allow.

A file takes up to 512 KiB, 1000 faults and 524288 cells, where cells are the records of each
file from 0 to its last one, and what is not 0 in the tables. Whatever it says, there are
devices or a `DeviceFileError` within a second.
"""

from __future__ import annotations

import contextlib
import re
import reprlib
import time
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import partial
from itertools import groupby, pairwise
from os import PathLike
from typing import Any, NamedTuple

from ..device.access import Access
from ..device.device import DEFAULT_SERVER_ID, Device
from ..device.mapping import Mapping as Tables
from ..device.record_file import RecordFile
from ..protocol.checks import integer
from ..protocol.errors import IllegalDataAddress
from ..protocol.pdu import RECORDS_PER_FILE, ServerId
from ..protocol.pdu.interface import OBJECT_NAMES
from ..protocol.tables import TABLES
from ..protocol.values import ValueType, value_type
from ..server.faults import Fault
from ..toml import roles
from ..toml.bounded import read_toml
from ..toml.files import load_file
from ..toml.lines import below, shown_key
from .behaviour import BEHAVIOURS, BIT, Clockwork, Run

__all__ = ["DeviceFileError", "Simulation", "load", "parse"]

# Eight units with full tables that are not 0; more would take seconds and memory to write.
MAX_CELLS = 1 << 19

# All of them are looked at for each request.
MAX_FAULTS = 1000

# Checks a value, whose name is given for the error, and gives what it stands for.
Check = Callable[[str, object], Any]


class DeviceFileError(ValueError):
    """A device file that cannot be: which file, line and key, and what is allowed."""


class Simulation(NamedTuple):
    """
    What a device file describes; ``Server(*load("plant.toml"))`` serves it.

    Attributes:
        devices: by unit, or one that answers every unit.
        faults: by unit; those of None are for every unit.
    """

    devices: Device | dict[int, Device]
    faults: dict[int | None, list[Fault]]


def load(path: str | PathLike[str], *, clock: Callable[[], float] = time.monotonic) -> Simulation:
    """
    Read a device file. Its values begin to move now.

    Args:
        path: of the file.
        clock: gives seconds.

    Raises:
        DeviceFileError: it cannot be read, is no TOML, or says what cannot be.
    """
    return load_file(path, partial(parse, clock=clock), DeviceFileError)


def parse(text: str, *, clock: Callable[[], float] = time.monotonic) -> Simulation:
    """
    Read the text of a device file.

    Raises:
        DeviceFileError: it is no TOML, or says what cannot be.
    """
    with _inside(""):
        content = read_toml(text)
    given = _checked("", content, FILE, required=("unit",))
    faults: dict[int | None, list[Fault]] = {None: _faults("fault", given)}
    devices: dict[int | None, Device] = {}
    budget = _Budget()
    of_all = {"roles": given["roles"]} if "roles" in given else {}
    for at, own in enumerate(given["unit"]):
        where, unit = f"unit[{at}]", of_all | own
        if "id" not in unit and len(given["unit"]) > 1:
            raise DeviceFileError(f"{where}.id is missing; only a single unit can be without")
        number, device = _unit(where, unit, clock, budget)
        if number in devices:
            raise DeviceFileError(f"{where}.id: there is a unit {number} before this")
        devices[number] = device
        faults[number] = faults.get(number, []) + _faults(f"{where}.fault", unit)
        if sum(map(len, faults.values())) > MAX_FAULTS:
            raise DeviceFileError(f"{where}.fault: more than {MAX_FAULTS} faults in one file")
    if not devices:
        raise DeviceFileError("unit must hold at least one")
    return Simulation(_by_unit(devices), {unit: found for unit, found in faults.items() if found})


def _by_unit(devices: dict[int | None, Device]) -> Device | dict[int, Device]:
    if None in devices:
        return devices[None]
    return {unit: device for unit, device in devices.items() if unit is not None}


# --- checks --------------------------------------------------------------------------


@contextlib.contextmanager
def _inside(where: str) -> Iterator[None]:
    """Say where it was, unless the message says it itself."""
    try:
        yield
    except DeviceFileError:
        raise
    except (TypeError, ValueError) as error:
        raise DeviceFileError(f"{where}{error}") from None


def _checked(
    where: str,
    given: Mapping[str, object],
    allowed: Mapping[str, Check],
    required: Iterable[str] = (),
) -> dict[str, Any]:
    """Check the keys of a TOML table and their values; `where` ends with a dot, or is empty."""
    for key in given:
        if key not in allowed:
            raise DeviceFileError(
                f"{where}{shown_key(key)}: no such key; allowed are {', '.join(allowed)}"
            )
    for key in required:
        if key not in given:
            raise DeviceFileError(f"{where}{key} is missing")
    with _inside(""):
        return {key: allowed[key](f"{where}{key}", value) for key, value in given.items()}


def _integer(low: int, high: int) -> Check:
    return lambda name, value: integer(name, value, low, high)


def _unit_id(name: str, value: object) -> int:
    number = integer(name, value, 0, 255)
    if 247 < number < 255:
        raise ValueError(f"{name} must be in 0..247, or 255, not {number}")
    return number


def _a(kind: type, what: str) -> Check:
    def check(name: str, value: object) -> Any:
        if not isinstance(value, kind):
            raise TypeError(f"{name} must be {what}, not {_given(value)}")
        return value

    return check


_flag = _a(bool, "true or false")
_table = _a(dict, "a table")
_list = _a(list, "a list")


def _tables(name: str, value: object) -> list[dict[str, object]]:
    if not isinstance(value, list):
        raise TypeError(f"{name} must be a list of tables: [[{re.sub('[^a-z._]', '', name)}]]")
    return [_table(f"{name}[{at}]", each) for at, each in enumerate(value)]


def _anything(name: str, value: object) -> object:
    return value


def _bytes(low: int, high: int) -> Check:
    """Text, or a list of bytes for what is none."""

    def check(name: str, value: object) -> bytes:
        if isinstance(value, list):
            numbers = enumerate(value)
            data = bytes(integer(f"{name}[{at}]", number, 0, 255) for at, number in numbers)
        elif isinstance(value, str) and value.isascii():
            data = value.encode("ascii")
        else:
            raise TypeError(f"{name} must be ASCII text or a list of bytes, not {_given(value)}")
        if not low <= len(data) <= high:
            raise ValueError(f"{name} must have {low}..{high} bytes, not {len(data)}")
        return data

    return check


def _one_of(*choices: str) -> Check:
    def check(name: str, value: object) -> str:
        if value not in choices:
            raise ValueError(f"{name} must be one of {', '.join(choices)}, not {_given(value)}")
        return str(value)

    return check


def _made_by(make: Callable[..., Any]) -> Check:
    """A dataclass that checks itself: its attributes are the keys."""
    attributes = fields(make)  # type: ignore[arg-type]
    allowed: dict[str, Check] = {attribute.name: _anything for attribute in attributes}
    required = [attribute.name for attribute in attributes if attribute.default is MISSING]

    def check(name: str, value: object) -> Any:
        given = _checked(f"{name}.", _table(name, value), allowed, required)
        with _inside(f"{name}."):
            return make(**given)

    return check


def _given(value: object) -> str:
    return reprlib.repr(value)


# --- what there is -------------------------------------------------------------------

ACCESS = {
    "read_write": (True, True),
    "read": (True, False),
    "write": (False, True),
}
"""How a range can be accessed -> whether clients can read, and write."""

FILE: dict[str, Check] = {"unit": _tables, "fault": _tables, "roles": roles.rules}

UNIT: dict[str, Check] = {
    "id": _unit_id,
    "exception_status": _integer(0, 255),
    "server_id": _table,
    "identification": _table,
    "coils": _tables,
    "discrete_inputs": _tables,
    "holding_registers": _tables,
    "input_registers": _tables,
    "file": _tables,
    "fifo": _tables,
    "fault": _tables,
    "roles": roles.rules,
}

SERVER_ID: dict[str, Check] = {
    "identifier": _bytes(1, 125),
    "running": _flag,
    "additional": _bytes(0, 125),
}

FIFO: dict[str, Check] = {"address": _integer(0, 0xFFFF), "values": _list}

CONTENT: dict[str, Check] = {"value": _anything, "values": _list}

TYPE: dict[str, Check] = {
    "type": _anything,
    "order": _anything,
    "encoding": _anything,
    "padding": _anything,
}

PLACE: dict[str, Check] = {"address": _integer(0, 0xFFFF), "count": _integer(1, 0x10000)}

MOVES: dict[str, Check] = {name: _made_by(make) for name, make in BEHAVIOURS.items()}

CAN: dict[str, Check] = {"access": _one_of(*ACCESS)}

RANGES: dict[str, dict[str, Check]] = {
    "coils": PLACE | CONTENT | CAN | MOVES,
    "discrete_inputs": PLACE | CONTENT | MOVES,
    "holding_registers": PLACE | CONTENT | TYPE | CAN | MOVES,
    "input_registers": PLACE | CONTENT | TYPE | MOVES,
    "file": {
        "number": _integer(1, 0xFFFF),
        "record": _integer(0, RECORDS_PER_FILE - 1),
        "count": _integer(1, RECORDS_PER_FILE),
    }
    | CONTENT
    | TYPE
    | CAN,
}
"""Table -> the keys of its ranges."""


# --- ranges --------------------------------------------------------------------------


class _Budget:
    """What cells a file may still have."""

    def __init__(self) -> None:
        self._left = MAX_CELLS

    def spend(self, where: str, cells: int) -> None:
        self._left -= cells
        if self._left < 0:
            raise DeviceFileError(f"{where}: more than {MAX_CELLS} cells in one file")


@dataclass(frozen=True)
class _Range:
    """One range, as given: where in the device file, and what. `cells` may be repeated."""

    where: str
    run: Run
    cells: array[int]
    access: str
    behaviour: str = ""
    file: int = 0

    @property
    def place(self) -> tuple[str, int]:
        return self.run.table, self.file

    @property
    def all_cells(self) -> array[int]:
        return self.cells * ((self.run.stop - self.run.first) // len(self.cells))


def _ranges(where: str, table: str, unit: Mapping[str, Any]) -> list[_Range]:
    found = [
        _range(f"{where}{table}[{at}]", table, given)
        for at, given in enumerate(unit.get(table, ()))
    ]
    in_order = sorted(found, key=lambda each: (each.file, each.run.first))
    for before, after in pairwise(in_order):
        if before.place == after.place and after.run.first < before.run.stop:
            taken = f"{before.where} ({before.run.first}..{before.run.stop - 1})"
            raise DeviceFileError(f"{after.where} begins at {after.run.first}, within {taken}")
    return found


def _range(where: str, table: str, raw: dict[str, object]) -> _Range:
    needs = ("number", "record") if table == "file" else ("address",)
    given = _checked(f"{where}.", raw, RANGES[table], needs)
    sources = [key for key in given if key in CONTENT or key in MOVES]
    if len(sources) > 1:
        raise DeviceFileError(f"{where}.{sources[1]} means nothing beside {sources[0]}")
    behaviour = sources[0] if sources and sources[0] in MOVES else ""
    if behaviour and given.get("access", "read") != "read":
        # What a client wrote would be gone at the next read.
        raise DeviceFileError(f"{where}.access must be read for what moves by itself")
    kind = _kind(where, table, given)
    first = given["record" if table == "file" else "address"]
    run = Run(table, first, _count(where, given), kind, given[behaviour] if behaviour else None)
    end = RECORDS_PER_FILE if table == "file" else 0x10000
    if run.stop > end:
        raise DeviceFileError(f"{where} ends at {run.stop - 1}, after {end - 1}")
    cells = array("H", _cells(where, given, kind))
    access = given.get("access", "read" if behaviour else "read_write")
    return _Range(where, run, cells, access, behaviour, given.get("number", 0))


def _kind(where: str, table: str, given: dict[str, Any]) -> ValueType:
    if table in ("coils", "discrete_inputs"):
        return BIT
    name, *_ = [key for key in given if key in TYPE] or [""]
    if name and "type" not in given:
        raise DeviceFileError(f"{where}.{name} means nothing without type")
    options = {key: value for key, value in given.items() if key in TYPE and key != "type"}
    with _inside(f"{where}."):
        return value_type(given.get("type", "uint16"), **options)


def _count(where: str, given: dict[str, Any]) -> int:
    """How many values there are."""
    if "values" not in given:
        return int(given.get("count", 1))
    if "count" in given:
        raise DeviceFileError(f"{where}.count means nothing beside values")
    if not given["values"]:
        raise DeviceFileError(f"{where}.values must hold at least one")
    return len(given["values"])


def _cells(where: str, given: dict[str, Any], kind: ValueType) -> list[int]:
    """What they are at first; one of them, if all are the same."""
    if "values" not in given:
        zero = "" if kind.is_text else kind.decode([0] * kind.registers)
        return _encoded(f"{where}.value", kind, given.get("value", zero))
    cells: list[int] = []
    for at, value in enumerate(given["values"]):
        cells += _encoded(f"{where}.values[{at}]", kind, value)
    return cells


def _encoded(where: str, kind: ValueType, value: object) -> list[int]:
    try:
        return kind.encode(value)
    except (TypeError, ValueError) as error:
        # The message begins with the name that the value has there.
        raise DeviceFileError(f"{where}{str(error).removeprefix('value')}") from None


class _Rules:
    """What clients may not do, and what moves when they read: the hooks of a device."""

    def __init__(self, ranges: list[_Range], clockwork: Clockwork) -> None:
        self._clockwork = clockwork
        self._unreadable = _by_place(each for each in ranges if not ACCESS[each.access][0])
        self._unwritable = _by_place(each for each in ranges if not ACCESS[each.access][1])

    def before_read(self, access: Access) -> None:
        _check(self._unreadable, access, "read")
        if access.table in TABLES:
            self._clockwork.refresh(access.table, access.address, access.count)

    def before_write(self, access: Access) -> None:
        _check(self._unwritable, access, "written")


# (table, file) -> runs, in order.
_Runs = dict[tuple[str, int], list[Run]]


def _by_place(ranges: Iterable[_Range]) -> _Runs:
    runs: _Runs = {}
    for each in sorted(ranges, key=lambda each: each.run.first):
        runs.setdefault(each.place, []).append(each.run)
    return runs


def _check(forbidden: _Runs, access: Access, what: str) -> None:
    runs = forbidden.get((access.table, access.file), [])
    stop = access.address + access.count
    at = bisect_left(runs, stop, key=lambda run: run.first) - 1  # the last that begins before
    if at >= 0 and access.address < runs[at].stop:
        span = f"{access.table} {access.address}..{stop - 1}"
        raise IllegalDataAddress(f"{span} cannot all be {what}")


# --- units ---------------------------------------------------------------------------


def _unit(
    where: str, raw: dict[str, object], clock: Callable[[], float], budget: _Budget
) -> tuple[int | None, Device]:
    given = _checked(f"{where}.", raw, UNIT)
    ranges = [found for table in RANGES for found in _ranges(f"{where}.", table, given)]
    in_tables = [each for each in ranges if each.run.table in TABLES]
    mapping = _mapping(in_tables, budget)
    clockwork = Clockwork(mapping, [each.run for each in in_tables], clock)
    for each in in_tables:
        with _inside(f"{each.where}.{each.behaviour}: "):
            clockwork.start(each.run)
    rules = _Rules(ranges, clockwork)
    device = Device(
        mapping,
        fifos=_fifos(f"{where}.fifo", given),
        identification=_identification(f"{where}.identification", given),
        server_id=_server_id(f"{where}.server_id.", given),
        exception_status=given.get("exception_status", 0),
        before_write=rules.before_write,
        before_read=rules.before_read,
        authorize=given.get("roles"),
    )
    device.files.update(_files([each for each in ranges if each.run.table == "file"], budget))
    return given.get("id"), device


def _mapping(ranges: list[_Range], budget: _Budget) -> Tables:
    places: dict[str, list[range]] = {table: [] for table in TABLES}
    for each in ranges:
        places[each.run.table].append(range(each.run.first, each.run.stop))
    mapping = Tables(**places)
    for each in ranges:
        if any(each.cells):  # zeros are there already, and take no memory
            budget.spend(each.where, each.run.stop - each.run.first)
            getattr(mapping, each.run.table)[each.run.first : each.run.stop] = each.all_cells
    return mapping


def _files(ranges: list[_Range], budget: _Budget) -> Iterator[tuple[int, RecordFile]]:
    """One after the other, for its records take more memory while they are put together."""
    in_order = sorted(ranges, key=lambda each: (each.file, each.run.first))
    for number, parts in groupby(in_order, key=lambda each: each.file):
        records: dict[int, int] = {}
        before = 0
        for each in parts:
            budget.spend(each.where, each.run.stop - before)
            before = each.run.stop
            records.update(enumerate(each.all_cells, start=each.run.first))
        yield number, RecordFile(records)


def _fifos(where: str, unit: Mapping[str, Any]) -> dict[int, list[int]]:
    fifos: dict[int, list[int]] = {}
    for at, raw in enumerate(unit.get("fifo", ())):
        prefix = f"{where}[{at}]."
        given = _checked(prefix, raw, FIFO, required=FIFO)
        address, values = given["address"], given["values"]
        if address in fifos:
            raise DeviceFileError(f"{prefix}address: there is a queue at {address} before this")
        if len(values) > 31:
            raise DeviceFileError(f"{prefix}values must be 0..31, not {len(values)}")
        with _inside(prefix):
            numbers = enumerate(values)
            fifos[address] = [integer(f"values[{i}]", value, 0, 0xFFFF) for i, value in numbers]
    return fifos


def _identification(where: str, unit: Mapping[str, Any]) -> dict[str | int, str | bytes]:
    objects: dict[str | int, str | bytes] = {}
    check = _bytes(0, 244)
    for key, value in unit.get("identification", {}).items():
        number = _object_id(where, key)
        if number in objects:
            raise DeviceFileError(f"{below(where, key)}: there is an object {number} before this")
        with _inside(f"{where}."):
            objects[number] = check(key, value)
    return objects


def _object_id(where: str, key: str) -> int:
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    number = numbers.get(key, int(key) if key.isdecimal() and len(key) < 4 else -1)
    if number not in OBJECT_NAMES and not 0x80 <= number <= 0xFF:
        names = ", ".join(numbers)
        raise DeviceFileError(
            f"{below(where, key)}: no such key; allowed are {names}, and the numbers 0..6, 128..255"
        )
    return number


def _server_id(where: str, unit: Mapping[str, Any]) -> ServerId:
    given = _checked(where, unit.get("server_id", {}), SERVER_ID)
    return DEFAULT_SERVER_ID._replace(**given)


def _faults(where: str, given: Mapping[str, Any]) -> list[Fault]:
    make = _made_by(Fault)
    return [make(f"{where}[{at}]", each) for at, each in enumerate(given.get("fault", ()))]
