"""
Files of records and FIFO queues, which a device has besides its tables; checked when they are set.
"""

from __future__ import annotations

import reprlib
from array import array
from collections import UserDict
from collections.abc import Iterable, Iterator, MutableSequence
from collections.abc import Mapping as MappingABC
from itertools import compress
from operator import index
from typing import Any, TypeAlias, overload

from ..protocol.checks import integer
from ..protocol.mistakes import WrongType, inside
from ..protocol.pdu import RECORDS_PER_FILE

Records: TypeAlias = int | Iterable[int] | MappingABC[int, int]
"""The number of records, or their values."""


class RecordFile:
    """
    One file: registers with record numbers 0..9999, not all of which need to exist.

    ``file[record]`` reads and writes one record; ``len`` and iteration cover
    the records that exist, in ascending order.

    Args:
        records: the number of records, 0..10000, all 0; or the values, 0..65535, from record 0 on;
            or ``{record: value}``.

    Raises:
        TypeError, ValueError: a record or value is out of range.
        IndexError: a record does not exist.
    """

    def __init__(self, records: Records) -> None:
        if isinstance(records, int) and not isinstance(records, bool):
            records = [0] * integer("records", records, 0, RECORDS_PER_FILE)
        if not isinstance(records, Iterable) or isinstance(records, str):
            kinds = "a number of records, a list of values or {record: value}"
            raise WrongType("records", f"must be {kinds}, not {reprlib.repr(records)}")
        if not isinstance(records, MappingABC):
            records = dict(enumerate(records))
        numbers = [integer("record", record, 0, RECORDS_PER_FILE - 1) for record in records]
        self._values = array("H", bytes(2 * (max(numbers, default=-1) + 1)))
        self._exists = bytearray(len(self._values))
        for record, value in zip(numbers, records.values(), strict=True):
            self._values[record] = integer("value", value, 0, 0xFFFF)
            self._exists[record] = 1

    def __getitem__(self, record: int) -> int:
        return self._values[self._existing(record)]

    def __setitem__(self, record: int, value: int) -> None:
        self._values[self._existing(record)] = integer("value", value, 0, 0xFFFF)

    def __len__(self) -> int:
        return self._exists.count(1)

    def __iter__(self) -> Iterator[int]:
        return compress(self._values, self._exists)

    @property
    def view(self) -> memoryview:
        """The memory of the records from 0 on, not a copy; records that do not exist are 0."""
        return memoryview(self._values)

    def has(self, record: int, length: int) -> bool:
        """Return True if `length` records, starting at `record`, all exist."""
        return record + length <= len(self._values) and all(self._exists[record : record + length])

    def read(self, record: int, length: int) -> list[int]:
        """Return `length` records, all of which must exist (`has`)."""
        return self._values[record : record + length].tolist()

    def write(self, record: int, values: tuple[int, ...]) -> None:
        """Set records, all of which must exist (`has`)."""
        self._values[record : record + len(values)] = array("H", values)

    def _existing(self, record: int) -> int:
        number = index(record)
        if number < 0 or not self.has(number, 1):
            raise IndexError(f"no record {record}")
        return number


class FifoQueue(MutableSequence[int]):
    """
    One queue: a list of registers 0..65535, the oldest first.

    Clients get exception 3 (illegal data value) while there are more than 31 of them.

    Args:
        registers: the registers.

    Raises:
        TypeError, ValueError: a register is wrong, here or when it is set.
    """

    def __init__(self, registers: Iterable[int] = ()) -> None:
        if not isinstance(registers, Iterable) or isinstance(registers, str):
            raise WrongType((), f"must be a list of registers, not {reprlib.repr(registers)}")
        self._registers: list[int] = _registers(registers)

    @overload
    def __getitem__(self, at: int) -> int: ...

    @overload
    def __getitem__(self, at: slice) -> list[int]: ...

    def __getitem__(self, at: int | slice) -> int | list[int]:
        return self._registers[at]

    @overload
    def __setitem__(self, at: int, value: int) -> None: ...

    @overload
    def __setitem__(self, at: slice, value: Iterable[int]) -> None: ...

    def __setitem__(self, at: int | slice, value: Any) -> None:
        if isinstance(at, slice):
            self._registers[at] = _registers(value)
        else:
            self._registers[at] = _register(value)

    def __delitem__(self, at: int | slice) -> None:
        del self._registers[at]

    def __len__(self) -> int:
        return len(self._registers)

    def __iter__(self) -> Iterator[int]:
        return iter(self._registers.copy())

    def __eq__(self, other: object) -> bool:
        if isinstance(other, FifoQueue):
            return self._registers == other._registers
        return self._registers == other if isinstance(other, list) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # as of a list

    def __repr__(self) -> str:
        return f"FifoQueue({self._registers})"

    def insert(self, at: int, value: int) -> None:
        """Insert a register."""
        self._registers.insert(at, _register(value))


def _register(value: object) -> int:
    return integer("a register", value, 0, 0xFFFF)


def _registers(values: Iterable[object]) -> list[int]:
    return [integer((at,), value, 0, 0xFFFF) for at, value in enumerate(values)]


class Files(UserDict[int, RecordFile]):
    """The files of a device: ``{number: RecordFile}``; records that are set become a RecordFile."""

    def __init__(self, files: MappingABC[int, RecordFile | Records] | None = None) -> None:
        super().__init__()
        for number, records in items_of("files", "{file number: records}", files):
            self[number] = records

    def __setitem__(self, number: int, records: RecordFile | Records) -> None:
        with inside("files", number):
            key = integer((), number, 1, 0xFFFF)
            self.data[key] = records if isinstance(records, RecordFile) else RecordFile(records)


class Queues(UserDict[int, FifoQueue]):
    """The queues of a device: ``{pointer address: FifoQueue}``; lists that are set become one."""

    def __init__(self, fifos: MappingABC[int, Iterable[int]] | None = None) -> None:
        super().__init__()
        for address, registers in items_of("fifos", "{pointer address: registers}", fifos):
            self[address] = registers

    def __setitem__(self, address: int, registers: Iterable[int]) -> None:
        key = integer("fifo", address, 0, 0xFFFF)
        with inside("fifos", address):
            if not isinstance(registers, FifoQueue):
                registers = FifoQueue(registers)
            self.data[key] = registers


def items_of(name: str, form: str, mapping: Any) -> Iterable[tuple[Any, Any]]:
    """Return the items of an argument that must be a mapping; None has none."""
    if mapping is not None and not isinstance(mapping, MappingABC):
        raise WrongType(name, f"must be {form}, not {reprlib.repr(mapping)}")
    return (mapping or {}).items()
