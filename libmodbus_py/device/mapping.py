"""
The four tables of a device, inside a modbus_mapping_t that libmodbus answers from.

The tables are anonymous memory of our own, so a view outlives the mapping, and pages that were
never written take no memory.
"""

from __future__ import annotations

import mmap
import threading
import weakref
from abc import ABC, abstractmethod
from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from collections.abc import Mapping as MappingABC
from itertools import pairwise
from operator import index
from typing import Any, ClassVar, Generic, Literal, Self, TypeAlias, TypeVar, Unpack, overload

from ..binding.library import TABLE_NUMBERS, ffi, runs
from ..protocol.checks import integer
from ..protocol.mistakes import named_arguments
from ..protocol.tables import TABLE_SIZE, checked_ranges, joined, without
from ..protocol.values import Layout, TypeName, value_type
from ..system import call_in_children

Cell = TypeVar("Cell", bool, int)

Contents: TypeAlias = int | range | Iterable[range] | MappingABC[int, Iterable[int]]
"""The number of cells, or their addresses, or their values."""


class Table(ABC, Generic[Cell]):
    """
    One table of a mapping, indexed by Modbus address: ``table[address]``, ``table[start:stop]``,
    and assignment to both; iteration and ``len`` leave out holes.

    A missing start or stop of a slice is that of the table. Every access takes the mapping's lock.
    An address that does not exist is an IndexError.
    """

    typecode: ClassVar[Literal["B", "H"]]

    def __init__(self, name: str, contents: Contents, lock: threading.RLock) -> None:
        self._name = name
        first = _values(name, contents) if isinstance(contents, MappingABC) else {}
        if isinstance(contents, MappingABC):
            contents = [range(at, at + len(values)) for at, values in first.items()]
        self._ranges: tuple[range, ...] = _ranges(name, contents)
        ranges = self._ranges
        self._starts = [run.start for run in ranges]
        self._addresses: range = range(ranges[0].start, ranges[-1].stop) if ranges else range(0)
        self._lock = lock
        size = len(self.addresses) * array(self.typecode).itemsize
        # An empty table has memory too, because mmap makes none of 0 bytes. Private: by
        # default a forked child would write into its parent's tables.
        self._memory = mmap.mmap(-1, max(size, 1), mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        self._cells: memoryview = memoryview(self._memory)[:size].cast(self.typecode)
        for at, values in first.items():
            self[at : at + len(values)] = values

    @property
    def name(self) -> str:
        """The attribute of the mapping, such as "coils"."""
        return self._name

    @property
    def addresses(self) -> range:
        """All addresses from the first to the last one."""
        return self._addresses

    @property
    def ranges(self) -> tuple[range, ...]:
        """The addresses that exist, joined, in ascending order."""
        return self._ranges

    @property
    @abstractmethod
    def view(self) -> memoryview:
        """
        The memory of the cells from the first address on, holes included; valid for ever.

        It does not take the lock: write to it inside ``with mapping:``.
        """

    @abstractmethod
    def _to_cell(self, value: object) -> int: ...

    @abstractmethod
    def _from_cells(self, cells: memoryview) -> list[Cell]: ...

    def has(self, address: int, count: int = 1) -> bool:
        """Return True if `count` addresses, starting at `address`, all exist."""
        at = bisect_right(self._starts, address) - 1  # `contains` takes twice the time
        return at >= 0 and address + count <= self._ranges[at].stop

    def __len__(self) -> int:
        return sum(map(len, self.ranges))

    def __iter__(self) -> Iterator[Cell]:
        with self._lock:
            return iter([value for run in self.ranges for value in self[run.start : run.stop]])

    def __repr__(self) -> str:
        spans = [_span(run) for run in self.ranges] or ["empty"]
        spans[8:] = [f"{len(spans) - 8} more"] if len(spans) > 8 else []
        return f"<{self.name} {', '.join(spans)}>"

    @overload
    def __getitem__(self, key: int) -> Cell: ...

    @overload
    def __getitem__(self, key: slice) -> list[Cell]: ...

    def __getitem__(self, key: int | slice) -> Cell | list[Cell]:
        place = self._place(key)
        with self._lock:
            values = self._from_cells(self._cells[place])
        return values if isinstance(key, slice) else values[0]

    @overload
    def __setitem__(self, key: int, value: Cell) -> None: ...

    @overload
    def __setitem__(self, key: slice, value: Iterable[Cell]) -> None: ...

    def __setitem__(self, key: int | slice, value: Any) -> None:
        place = self._place(key)
        values = value if isinstance(key, slice) else (value,)
        cells = array(self.typecode, [self._to_cell(item) for item in values])
        room = len(self._cells[place])
        if len(cells) != room:
            raise ValueError(f"{self.name}: {len(cells)} values for {room} addresses")
        with self._lock:
            self._cells[place] = memoryview(cells)

    def _place(self, key: int | slice) -> slice:
        first, end = self.addresses.start, self.addresses.stop
        if isinstance(key, slice):
            start = first if key.start is None else self._address(key.start)
            stop = end if key.stop is None else self._address(key.stop)
            step = 1 if key.step is None else self._address(key.step)
            if not (first <= start <= stop <= end and step >= 1):
                steps = "" if step == 1 else f":{step}"
                raise IndexError(f"no addresses {start}:{stop}{steps} in {self!r}")
            if len(self.ranges) > 1 and start < stop and not self.has(start, stop - start):
                (hole, *_) = without([range(start, stop)], self.ranges)
                raise IndexError(f"no address {hole.start} in {self!r}")
            return slice(start - first, stop - first, step)
        address = self._address(key)
        if not self.has(address):
            raise IndexError(f"no address {address} in {self!r}")
        return slice(address - first, address - first + 1)

    def _address(self, value: object) -> int:
        try:
            return index(value)  # type: ignore[arg-type]
        except TypeError:
            kind = type(value).__name__
            raise TypeError(f"an address in {self!r} is an integer, not {kind}") from None


class BitTable(Table[bool]):
    """
    Coils or discrete inputs: values are True and False.

    Cells are 0 or 1: libmodbus packs them without a check, so others would change their neighbours.
    """

    typecode: ClassVar[Literal["B", "H"]] = "B"

    @property
    def view(self) -> memoryview:
        """As `Table.view`, but read-only, so that every cell is 0 or 1."""
        return self._cells.toreadonly()

    def _to_cell(self, value: object) -> int:
        try:
            return int(index(value) != 0)  # type: ignore[arg-type]
        except TypeError:
            kind = type(value).__name__
            raise TypeError(f"{self.name}: a value is True or False, not {kind}") from None

    def _from_cells(self, cells: memoryview) -> list[bool]:
        return [cell != 0 for cell in cells]


class RegisterTable(Table[int]):
    """
    Holding or input registers: values are 0..65535.

    `read` and `write` handle one value of any type (`values`), `read_values` and `write_values` a
    list. Each call is one access: no request is answered in the middle of it, and if it fails,
    nothing has changed. The layout is `order`, `encoding` and `padding`, as of `values.value_type`.
    """

    typecode: ClassVar[Literal["B", "H"]] = "H"

    @property
    def view(self) -> memoryview:
        """As `Table.view`; writable, in the byte order of the machine."""
        return self._cells[:]  # another memoryview, because `with` releases it

    def read(self, address: int, type: TypeName, **layout: Unpack[Layout]) -> Any:
        """Read one value, such as ``read(100, "float32", order="CDAB")``."""
        kind = value_type(type, **layout)
        return kind.decode(self[self._run(address, kind.registers)])

    def read_values(
        self, address: int, type: TypeName, count: int = 1, **layout: Unpack[Layout]
    ) -> list[Any]:
        """Read `count` (1..65536) values of one type, one after the other."""
        kind = value_type(type, **layout)
        values = integer("count", count, 1, TABLE_SIZE)
        return kind.decode_many(self[self._run(address, values * kind.registers)])

    def write(self, address: int, value: Any, type: TypeName, **layout: Unpack[Layout]) -> None:
        """Write one value, such as ``write(100, 3.14, "float32", order="CDAB")``."""
        registers = value_type(type, **layout).encode(value)
        self[self._run(address, len(registers))] = registers

    def write_values(
        self, address: int, values: Iterable[Any], type: TypeName, **layout: Unpack[Layout]
    ) -> None:
        """Write values of one type, one after the other; no values change nothing."""
        registers = value_type(type, **layout).encode_many(values)
        self[self._run(address, len(registers))] = registers

    def _run(self, address: object, registers: int) -> slice:
        start = self._address(address)
        return slice(start, start + registers)

    def _to_cell(self, value: object) -> int:
        try:
            number = index(value)  # type: ignore[arg-type]
        except TypeError:
            kind = type(value).__name__
            raise TypeError(f"{self.name}: a value is an integer, not {kind}") from None
        if not 0 <= number <= 0xFFFF:
            raise ValueError(f"{self.name}: a value must be in 0..65535, not {number}")
        return number

    def _from_cells(self, cells: memoryview) -> list[int]:
        return cells.tolist()


@named_arguments
class Mapping:
    """
    The four tables of one device; all values are zero unless they are given.

    ``with mapping:`` combines several accesses into one: no request is answered in between. The
    block must not contain an ``await``, during which a server in the same loop would answer.

    Attributes:
        coils, discrete_inputs: the tables of bits (`BitTable`).
        holding_registers, input_registers: the tables of registers (`RegisterTable`).
        lock: the lock that ``with mapping:`` holds. After a fork the child may have another lock,
            and has its own copies of the tables.

    Args:
        coils, discrete_inputs, holding_registers, input_registers: the number of
            items, from address 0; or the range of their addresses
            (``range(100, 200)``), within 0..65535; or a list of ranges; or
            values, ``{first address: values}``. Addresses between ranges are holes,
            for which clients get exception 2 (illegal data address).

    Raises:
        TypeError, ValueError: an argument is none of these, or addresses overlap.

    Source: modbus_mapping_new_start_address, but this package allocates the memory.
    """

    def __init__(
        self,
        coils: Contents = 0,
        discrete_inputs: Contents = 0,
        holding_registers: Contents = 0,
        input_registers: Contents = 0,
    ) -> None:
        self._lock = threading.RLock()
        self._coils = BitTable("coils", coils, self._lock)
        self._discrete_inputs = BitTable("discrete_inputs", discrete_inputs, self._lock)
        self._holding_registers = RegisterTable("holding_registers", holding_registers, self._lock)
        self._input_registers = RegisterTable("input_registers", input_registers, self._lock)
        # As the members of a mapping_t are called: nb_bits, start_bits, tab_bits, and so on.
        self._tables: dict[str, Table[Any]] = {
            "bits": self._coils,
            "input_bits": self._discrete_inputs,
            "registers": self._holding_registers,
            "input_registers": self._input_registers,
        }
        self._struct = self._make_struct()
        _mappings.add(self)

    # Read-only, because C would go on answering from the former tables.

    @property
    def coils(self) -> BitTable:
        """The bits that clients read and write."""
        return self._coils

    @property
    def discrete_inputs(self) -> BitTable:
        """The bits that clients can only read."""
        return self._discrete_inputs

    @property
    def holding_registers(self) -> RegisterTable:
        """The registers that clients read and write."""
        return self._holding_registers

    @property
    def input_registers(self) -> RegisterTable:
        """The registers that clients can only read."""
        return self._input_registers

    @property
    def lock(self) -> threading.RLock:
        """The lock that ``with mapping:`` holds."""
        return self._lock

    def __enter__(self) -> Self:
        self._lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __repr__(self) -> str:
        return f"Mapping({', '.join(map(repr, self._tables.values()))})"

    def _renew_lock(self) -> None:
        """Free the lock in a forked child, where a thread that held it does not exist."""
        if self._lock.acquire(blocking=False):  # the lock is free, or this thread holds it
            self._lock.release()
            return
        self._lock = threading.RLock()
        for table in self._tables.values():
            table._lock = self._lock

    def _make_struct(self) -> Any:
        """Point a mapping_t at the tables; `_pointers` keeps the buffers alive."""
        struct = ffi.new("mapping_t *")
        self._pointers = []
        for suffix, table in self._tables.items():
            setattr(struct.tables, f"nb_{suffix}", len(table.addresses))
            setattr(struct.tables, f"start_{suffix}", table.addresses.start)
            # Not the cells: a memoryview that is visited and part of a reference cycle makes
            # the garbage collector of Python 3.11 crash (gh-77894).
            pointer = ffi.from_buffer(f"uint{8 * table.view.itemsize}_t[]", table._memory)
            setattr(struct.tables, f"tab_{suffix}", pointer)
            edges = runs(table.ranges)
            struct.ranges[TABLE_NUMBERS[table.name]] = (len(table.ranges), edges)
            self._pointers += [pointer, edges]
        return struct


_mappings: weakref.WeakSet[Mapping] = weakref.WeakSet()


def _renew_locks() -> None:
    for mapping in list(_mappings):
        mapping._renew_lock()


call_in_children(_renew_locks)


def _span(addresses: range) -> str:
    return f"{addresses.start}..{addresses.stop - 1}"


def _values(name: str, contents: MappingABC[Any, Any]) -> dict[int, list[Any]]:
    """Return first address -> the values from there on."""
    values: dict[int, list[Any]] = {}
    for key, items in contents.items():
        address = integer(f"{name}: an address", key, 0, TABLE_SIZE - 1)
        if not isinstance(items, Iterable):
            raise TypeError(f"{name}[{key}] must be a list of values, not {type(items).__name__}")
        if cells := list(items):
            values[address] = cells
    return values


def _ranges(name: str, contents: Any) -> tuple[range, ...]:
    if isinstance(contents, int) and not isinstance(contents, bool):
        if not 0 <= contents <= TABLE_SIZE:
            raise ValueError(f"{name} must be in 0..{TABLE_SIZE}, not {contents}")
        contents = range(contents)
    ranges = checked_ranges(name, contents, "a count, ranges of addresses or {address: values}")
    for before, run in pairwise(filter(None, ranges)):
        if run.start < before.stop:
            raise ValueError(f"{name}: {_span(run)} overlaps {_span(before)}")
    return joined(ranges)
