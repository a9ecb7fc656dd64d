"""
The types of values by the names of their types, for type checkers.

``read_value("holding_registers", 100, "float32")`` is a float on a blocking client, and one to
await on the other. Nothing here runs.
"""

from __future__ import annotations

from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, Unpack, overload

if TYPE_CHECKING:
    from ..protocol.tables import RegisterTable
    from ..protocol.words import BitsType, FloatType, IntegerType, Layout, TextType, TypeName
    from .requests import Awaiting, Blocking

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


Result = TypeVar("Result")
Later = Coroutine[Any, Any, Result]


class OneByType:
    """The method `read_value` of both clients."""

    @overload
    def __get__(
        self, client: Blocking, owner: object
    ) -> ReadOne[int, float, list[bool], str, Any]: ...
    @overload
    def __get__(
        self, client: Awaiting, owner: object
    ) -> ReadOne[Later[int], Later[float], Later[list[bool]], Later[str], Later[Any]]: ...
    @overload
    def __get__(self, client: None, owner: object) -> Any: ...
    def __get__(self, client: Any, owner: object) -> Any: ...


class SeveralByType:
    """The method `read_values` of both clients."""

    @overload
    def __get__(
        self, client: Blocking, owner: object
    ) -> ReadSeveral[list[int], list[float], list[list[bool]], list[str], list[Any]]: ...
    @overload
    def __get__(
        self, client: Awaiting, owner: object
    ) -> ReadSeveral[
        Later[list[int]],
        Later[list[float]],
        Later[list[list[bool]]],
        Later[list[str]],
        Later[list[Any]],
    ]: ...
    @overload
    def __get__(self, client: None, owner: object) -> Any: ...
    def __get__(self, client: Any, owner: object) -> Any: ...


def one_by_type(method: object) -> OneByType:
    raise NotImplementedError


def several_by_type(method: object) -> SeveralByType:
    raise NotImplementedError
