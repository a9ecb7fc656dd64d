"""
The types of values by the names of their types, for type checkers.

``read_value("holding_registers", 100, "float32")`` is a float on a blocking client, and one to
await on the other. Nothing here runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar, Unpack, overload

if TYPE_CHECKING:
    from ..protocol.tables import RegisterTable
    from ..protocol.words import BitsType, FloatType, IntegerType, Layout, TextType, TypeName
    from .requests import Later, OfBoth

__all__ = ["one_by_type", "several_by_type"]

Integer = TypeVar("Integer", covariant=True)
Real = TypeVar("Real", covariant=True)
Bits = TypeVar("Bits", covariant=True)
Text = TypeVar("Text", covariant=True)
Unknown = TypeVar("Unknown", covariant=True)


class ReadOne(Protocol[Integer, Real, Bits, Text, Unknown]):
    """A method that reads one value, with its result for each kind of type."""

    @overload
    def __call__(
        self, /, table: RegisterTable, address: int, type: IntegerType, **layout: Unpack[Layout]
    ) -> Integer: ...
    @overload
    def __call__(
        self, /, table: RegisterTable, address: int, type: FloatType, **layout: Unpack[Layout]
    ) -> Real: ...
    @overload
    def __call__(
        self, /, table: RegisterTable, address: int, type: BitsType, **layout: Unpack[Layout]
    ) -> Bits: ...
    @overload
    def __call__(
        self, /, table: RegisterTable, address: int, type: TextType, **layout: Unpack[Layout]
    ) -> Text: ...
    @overload
    def __call__(
        self, /, table: RegisterTable, address: int, type: TypeName, **layout: Unpack[Layout]
    ) -> Unknown: ...


class ReadSeveral(Protocol[Integer, Real, Bits, Text, Unknown]):
    """A method that reads some values, with its result for each kind of type."""

    @overload
    def __call__(
        self,
        /,
        table: RegisterTable,
        address: int,
        type: IntegerType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> Integer: ...
    @overload
    def __call__(
        self,
        /,
        table: RegisterTable,
        address: int,
        type: FloatType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> Real: ...
    @overload
    def __call__(
        self,
        /,
        table: RegisterTable,
        address: int,
        type: BitsType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> Bits: ...
    @overload
    def __call__(
        self,
        /,
        table: RegisterTable,
        address: int,
        type: TextType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> Text: ...
    @overload
    def __call__(
        self,
        /,
        table: RegisterTable,
        address: int,
        type: TypeName,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> Unknown: ...


def one_by_type(
    method: object,
) -> OfBoth[
    ReadOne[int, float, list[bool], str, Any],
    ReadOne[Later[int], Later[float], Later[list[bool]], Later[str], Later[Any]],
]:
    raise NotImplementedError


def several_by_type(
    method: object,
) -> OfBoth[
    ReadSeveral[list[int], list[float], list[list[bool]], list[str], list[Any]],
    ReadSeveral[
        Later[list[int]],
        Later[list[float]],
        Later[list[list[bool]]],
        Later[list[str]],
        Later[list[Any]],
    ],
]:
    raise NotImplementedError
