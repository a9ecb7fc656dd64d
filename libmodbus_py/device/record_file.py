"""
Records of files, which functions 20 and 21 read and write.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from collections.abc import Mapping as MappingABC
from itertools import compress
from operator import index

from ..protocol.checks import integer
from ..protocol.pdu import RECORDS_PER_FILE

__all__ = ["RecordFile"]


class RecordFile:
    """
    One file: registers with record numbers 0..9999, not all of which need to exist.

    ``file[record]`` reads and writes one record; ``len`` and iteration cover
    the records that exist, in ascending order.

    Args:
        records: the values, 0..65535, from record 0 on, or ``{record: value}``.

    Raises:
        TypeError, ValueError: a record or value is out of range.
        IndexError: a record does not exist.
    """

    def __init__(self, records: Iterable[int] | MappingABC[int, int]) -> None:
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
