"""What is read by a plan: the items, with their types, and their values by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, Literal, Required, TypeAlias, TypedDict, TypeVar

from ..protocol.errors import ModbusError
from ..protocol.mistakes import WrongType, WrongValue, inside, named_arguments
from ..protocol.pdu.request import store
from ..protocol.tables import TABLES, RegisterTable, Table, checked_table, checked_values
from ..protocol.values import Order, TypeName, ValueType, value_type
from ..protocol.words import FloatType, PlainIntegerType

if TYPE_CHECKING:
    from datetime import datetime


@named_arguments
@dataclass(frozen=True)
class Read:
    """
    A read of consecutive cells of one table, or of values in its registers.

    Args:
        table: "coils", "discrete_inputs", "holding_registers" or "input_registers".
        address: the address of the first cell, 0..65535.
        count: the number of cells or values, 1 or more, up to the end of the table.
        type: the type of the values, such as "float32" (`libmodbus_py.values`), for registers
            only; None for the cells themselves.
        order, encoding, padding: the layout of the type, as for `values.value_type`.

    Attributes:
        kind: the `ValueType` of `type`, or None.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    table: Table
    address: int
    count: int = 1
    type: TypeName | None = None
    order: Order = "ABCD"
    encoding: str = "ascii"
    padding: str = "\0"
    kind: ValueType | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.table, str) or self.table not in TABLES:
            store(self, table=checked_table(self.table))
        store(self, kind=self._find_kind())
        if self.kind is not None:
            store(self, type=self.kind.name)
        address, count = checked_values(self.address, self.count, self.size)
        store(self, address=address, count=count)

    def _find_kind(self) -> ValueType | None:
        if self.type is None:
            if (self.order, self.encoding, self.padding) != ("ABCD", "ascii", "\0"):
                raise WrongValue("type", "must be given with order, encoding or padding")
            return None
        if TABLES[self.table].is_bits:
            raise WrongValue("type", f"must be None for {self.table}, not {self.type!r}")
        return value_type(self.type, order=self.order, encoding=self.encoding, padding=self.padding)

    @cached_property
    def size(self) -> int:
        """The number of cells of one value."""
        return 1 if self.kind is None else self.kind.registers

    @cached_property
    def cells(self) -> range:
        """The addresses of all cells."""
        return range(self.address, self.address + self.count * self.size)

    def decode(self, cells: Sequence[Any]) -> list[Any]:
        """
        Return the values of all cells.

        Args:
            cells: True and False, or registers 0..65535, as many as the attribute `cells`.

        Raises:
            TypeError, ValueError: the number of cells is wrong, or they hold no value of this type.
        """
        if len(cells) != len(self.cells):
            raise WrongValue("cells", f"must have {len(self.cells)} items, not {len(cells)}")
        return list(cells) if self.kind is None else self.kind.decode_many(cells)


# Of a literal, type checkers know the type of its values; of a tuple in a variable, they know none
# of its words.
BitItem: TypeAlias = (
    tuple[Literal["coils", "discrete_inputs"], int]
    | tuple[Literal["coils", "discrete_inputs"], int, int]
)
IntegerItem: TypeAlias = (
    tuple[RegisterTable, int]
    | tuple[RegisterTable, int, int]
    | tuple[RegisterTable, int, PlainIntegerType, *tuple[str, ...]]
    | tuple[RegisterTable, int, int, PlainIntegerType, *tuple[str, ...]]
)
FloatItem: TypeAlias = (
    tuple[RegisterTable, int, FloatType, *tuple[str, ...]]
    | tuple[RegisterTable, int, int, FloatType, *tuple[str, ...]]
)
AnyItem: TypeAlias = Read | tuple[str, int, *tuple[object, ...]] | tuple[str | int, ...]
"""A `Read`, or its arguments, of which the count may be left out before a type."""

Key = TypeVar("Key")
Items: TypeAlias = Iterable[AnyItem] | Mapping[Any, AnyItem]
Forbidden = Iterable[tuple[Table, range]]
Borders = Iterable[tuple[Table, int]]
Values: TypeAlias = "list[bool | int | float | str | datetime | list[bool] | None]"
"""The values of an item of any type."""
ValuesOfItem = TypeVar("ValuesOfItem")


class NamedValues(dict[Key, ValuesOfItem | ModbusError], Generic[Key, ValuesOfItem]):
    """The values that were read, by name; an error stands for those that could not be read."""

    @property
    def good(self) -> dict[Key, ValuesOfItem]:
        """The values that could be read, by name."""
        return {name: value for name, value in self.items() if not isinstance(value, ModbusError)}

    @property
    def failed(self) -> dict[Key, ModbusError]:
        """The errors of the others, by name."""
        return {name: value for name, value in self.items() if isinstance(value, ModbusError)}


class PlanOptions(TypedDict, total=False):
    """The options of a `Plan` that control how it merges reads; see `Plan`."""

    gap: int
    forbidden: Forbidden
    max_registers: int
    max_bits: int


class Strict(PlanOptions, total=False):
    """The options of `read_many` when every failure is raised."""

    return_exceptions: Literal[False]


class Tolerant(PlanOptions, total=False):
    """The options of `read_many` when a failed item gets a ModbusError in place of its values."""

    return_exceptions: Required[Literal[True]]


def checked_items(items: object) -> dict[Any, Read]:
    if isinstance(items, Mapping):
        return {name: _checked_item(name, item) for name, item in items.items()}
    if isinstance(items, Read | str | bytes) or not isinstance(items, Iterable):
        raise WrongType("items", f"must be a list of reads, not {type(items).__name__}")
    return {name: _checked_item(name, item) for name, item in enumerate(items)}


def _checked_item(name: object, item: object) -> Read:
    if isinstance(item, Read):
        return item
    path = f"items[{name!r}]"
    if not isinstance(item, tuple) or not 2 <= len(item) <= 7:
        raise WrongType(path, f"must be a Read or a tuple of its arguments, not {item!r}")
    arguments: list[Any] = [*item]
    if len(arguments) > 2 and isinstance(arguments[2], str):
        arguments.insert(2, 1)
    with inside(path):
        return Read(*arguments)
