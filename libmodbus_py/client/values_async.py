"""
The methods of clients that read and write values: of a type, such as "float32", and of the points
of register maps.

`packaging/generate_blocking.py` makes those of the blocking client of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Unpack, overload

from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import IllegalFunction
from .keywords import NoOthers, check_plan_options, public_methods, unexpected
from .many_async import AsyncMany

# Modules that only some methods need are imported by these.
if TYPE_CHECKING:
    from ..maps.items import NamedValues, PlanOptions, Tolerant
    from ..maps.register_map import AnyMap
    from ..protocol.tables import RegisterTable, WritableTable, WriteFunction
    from ..protocol.value_types import ValueType
    from ..protocol.words import (
        BitsType,
        FloatType,
        IntegerType,
        Layout,
        Order,
        TextType,
        TypeName,
    )

__all__ = ["AsyncValues"]


@public_methods("AsyncClient")
class AsyncValues(AsyncMany):
    """The methods for typed values and register maps; addresses are 0-based, 0..65535."""

    @overload
    async def read_value(  # type: ignore[overload-overlap]
        self, table: RegisterTable, address: int, type: IntegerType, **layout: Unpack[Layout]
    ) -> int: ...
    @overload
    async def read_value(  # type: ignore[overload-overlap]
        self, table: RegisterTable, address: int, type: FloatType, **layout: Unpack[Layout]
    ) -> float: ...
    @overload
    async def read_value(  # type: ignore[overload-overlap]
        self, table: RegisterTable, address: int, type: BitsType, **layout: Unpack[Layout]
    ) -> list[bool]: ...
    @overload
    async def read_value(
        self, table: RegisterTable, address: int, type: TextType, **layout: Unpack[Layout]
    ) -> str: ...
    @overload
    async def read_value(
        self, table: RegisterTable, address: int, type: TypeName, **layout: Unpack[Layout]
    ) -> Any: ...
    async def read_value(
        self,
        table: RegisterTable,
        address: int,
        type: TypeName,
        *,
        order: Order = "ABCD",
        encoding: str = "ascii",
        padding: str = "\0",
        **wrong: Unpack[NoOthers],
    ) -> Any:
        """
        Read one number, string, time or list of bits from registers.

        Args:
            table: "holding_registers" or "input_registers".
            address: the address of the first register.
            type: the type of the value, such as "float32"; see `libmodbus_py.values`.
            order: the order of the bytes, such as CDAB; see `libmodbus_py.values`.
            encoding, padding: the layout of strings, as for `values.value_type`.

        Raises:
            TypeError, ValueError: an argument is wrong.
            NoValue: the registers hold no such value; also a ValueError.
        """
        if wrong:
            raise unexpected(self.read_value, wrong)
        from ..protocol.tables import TABLES, register_table
        from ..protocol.values import value_type

        kind = value_type(type, order=order, encoding=encoding, padding=padding)
        request: pdu.Request[Any] = TABLES[register_table(table)].read(address, kind.registers)
        return _values_in(await self.execute(request), kind, f"{table} {address}")[0]

    @overload
    async def read_values(  # type: ignore[overload-overlap]
        self,
        table: RegisterTable,
        address: int,
        type: IntegerType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> list[int]: ...
    @overload
    async def read_values(  # type: ignore[overload-overlap]
        self,
        table: RegisterTable,
        address: int,
        type: FloatType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> list[float]: ...
    @overload
    async def read_values(  # type: ignore[overload-overlap]
        self,
        table: RegisterTable,
        address: int,
        type: BitsType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> list[list[bool]]: ...
    @overload
    async def read_values(
        self,
        table: RegisterTable,
        address: int,
        type: TextType,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> list[str]: ...
    @overload
    async def read_values(
        self,
        table: RegisterTable,
        address: int,
        type: TypeName,
        count: int = 1,
        **layout: Unpack[Layout],
    ) -> list[Any]: ...
    async def read_values(
        self,
        table: RegisterTable,
        address: int,
        type: TypeName,
        count: int = 1,
        *,
        order: Order = "ABCD",
        encoding: str = "ascii",
        padding: str = "\0",
        **wrong: Unpack[NoOthers],
    ) -> list[Any]:
        """
        Read values of one type from consecutive registers, with one request.

        Args:
            table: "holding_registers" or "input_registers".
            address: the address of the first register.
            type: the type of the values, such as "float32"; see `libmodbus_py.values`.
            count: the number of values, 1 or more; they take up to 125 registers.
            order: the order of the bytes, such as CDAB; see `libmodbus_py.values`.
            encoding, padding: the layout of strings, as for `values.value_type`.

        Raises:
            TypeError, ValueError: an argument is wrong.
            NoValue: some of the registers hold no such value; also a ValueError.
        """
        if wrong:
            raise unexpected(self.read_values, wrong)
        from ..protocol.tables import TABLES, register_table
        from ..protocol.values import value_type

        name = register_table(table)
        kind = value_type(type, order=order, encoding=encoding, padding=padding)
        registers = kind.registers * integer("count", count, 1, 125 // kind.registers)
        request: pdu.Request[Any] = TABLES[name].read(address, registers)
        return _values_in(await self.execute(request), kind, f"{table} {address}")

    async def write_value(
        self,
        table: WritableTable,
        address: int,
        value: Any,
        type: TypeName,
        *,
        order: Order = "ABCD",
        encoding: str = "ascii",
        padding: str = "\0",
        **wrong: Unpack[NoOthers],
    ) -> None:
        """
        Write one number, string, time or list of bits to holding registers.

        They are written with function 16; with ``write_function="single"``, each with function 6.

        Args:
            table: "holding_registers", the only table of registers that can be written.
            address: the address of the first register.
            value: the value, as `read_value` returns it.
            type, order, encoding, padding: as for `read_value`.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing was sent.
        """
        if wrong:
            raise unexpected(self.write_value, wrong)
        from ..protocol.tables import check_writable
        from ..protocol.values import value_type

        check_writable(table)
        kind = value_type(type, order=order, encoding=encoding, padding=padding)
        await self._write_registers(address, kind.encode(value))

    async def write_values(
        self,
        table: WritableTable,
        address: int,
        values: Iterable[Any],
        type: TypeName,
        *,
        order: Order = "ABCD",
        encoding: str = "ascii",
        padding: str = "\0",
        **wrong: Unpack[NoOthers],
    ) -> None:
        """
        Write values of one type to consecutive holding registers, as `write_value` does.

        Args:
            table: "holding_registers", the only table of registers that can be written.
            address: the address of the first register.
            values: one or more values, which take up to 123 registers.
            type, order, encoding, padding: as for `read_values`.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing was sent.
        """
        if wrong:
            raise unexpected(self.write_values, wrong)
        from ..protocol.tables import check_writable
        from ..protocol.values import value_type

        check_writable(table)
        kind = value_type(type, order=order, encoding=encoding, padding=padding)
        await self._write_registers(address, kind.encode_many(values))

    async def _write_registers(self, address: int, registers: list[int]) -> None:
        request = pdu.WriteRegisters(address, registers)  # type: ignore[arg-type]
        if self._write_function != "single":
            await self.execute(request)
            return
        for at, register in enumerate(request.values):
            await self.execute(pdu.WriteRegister(request.address + at, register))

    # --- register maps ------------------------------------------------------------------

    @overload
    async def read_map(
        self, map: AnyMap, names: Iterable[str] | None = None, **options: Unpack[Tolerant]
    ) -> NamedValues[str, Any]: ...
    @overload
    async def read_map(
        self,
        map: AnyMap,
        names: Iterable[str] | None = None,
        *,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> dict[str, Any]: ...
    async def read_map(
        self,
        map: AnyMap,
        names: Iterable[str] | None = None,
        *,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> dict[str, Any]:
        """
        Read points of a register map with few requests.

        Points that touch or overlap share a request; cells between points are only read if `gap`
        allows it. A device refuses a whole request because of a single cell that it lacks. The
        points that it refuses are found once, by halving the request. With `return_exceptions`
        they are then left out (`unreadable` lists them), and tried again, one at each call, after
        ten minutes and after a new connection. Without it, the refusal of the first of these
        points is raised, with the name of the point in `names`.

        Args:
            map: the register map, such as `load_map` returns; or the path of its file, which is
                then loaded at each call.
            names: the names of the points to read; None for all readable points. A program that
                often reads the same few points should make a `RegisterMap` of them.
            return_exceptions: True to return, in place of a value, a ModbusError if the point
                could not be read, and a `NoValue` with the reason where there is no value; a
                silent device costs one timeout, as for `read_many`. False to raise the first
                failure, and to return None where there is no value.
            options: the options of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Returns:
            The scaled values by name, as `Point.decode` returns them; None if the device reports
            that there is no value, if its registers hold none of its type, or if the value is not
            plausible. With `return_exceptions`, `good` and `failed` of the dict have the values
            and the errors.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be read; an option is wrong.
            MapError: as for `load_map`.
        """
        if options:
            check_plan_options(self.read_map, options)
        from ..maps.items import NamedValues
        from ..maps.register_map import map_of

        plan = map_of(map).plan(names, **options)
        answers = await self._answers(plan, return_exceptions)
        values = plan.results(answers, return_exceptions=return_exceptions)
        return NamedValues(values) if return_exceptions else values

    async def write_map(
        self,
        map: AnyMap,
        values: Mapping[str, Any],
        *,
        multiple: bool = False,
        **wrong: Unpack[NoOthers],
    ) -> None:
        """
        Write values to points of a register map.

        Names, access, types and ranges are all checked before the first byte is sent. Requests
        are sent in the order of the map, and adjacent points share one. If a request fails, its
        error is raised, and the requests after it are not sent.

        The functions are those of `write_function`. With "auto", what a device refuses with
        exception 1 to be written with function 5 or 6 is written with 15 or 16.

        Points with `scale_from` are written with the factor that the device has at that time: the
        points that hold the factors are read first. Parts of registers are written with function 22
        (mask write register). If the device lacks that function, the register is read, changed and
        written, and no other such change on this connection comes in between.

        Args:
            map: the register map, or the path of its file, as for `read_map`.
            values: the values by name, such as ``{"setpoint": 21.5}``; each is rounded to the
                nearest value that its scale can represent (`Point.encode`).
            multiple: True for ``write_function="multiple"`` in this call.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; a value does
                not fit its point; points share cells.
            MapError: as for `load_map`.
            NoValue: a point named by `scale_from` has no value that can be a scale.
        """
        if wrong:
            raise unexpected(self.write_map, wrong)
        from ..maps.register_map import map_of

        points = map_of(map)
        sources = points.scale_sources(values)
        read: dict[str, Any] = {}
        if sources:
            plan = points.plan(sources)
            read = plan.results(await self._run_batch(plan.requests, False))
        function: WriteFunction = "multiple" if multiple else self._write_function
        lacks_masks = False
        for request in points.writes(values, write_function=function, sources=read):
            if not isinstance(request, pdu.MaskWriteRegister):
                await self._write(request, function)
            elif lacks_masks:
                await self._change_register(request, function)
            else:
                try:
                    await self.execute(request)
                except IllegalFunction:
                    lacks_masks = True
                    await self._change_register(request, function)

    async def _write(self, request: pdu.Request[None], function: WriteFunction) -> None:
        try:
            await self.execute(request)
        except IllegalFunction:
            if function != "auto" or not isinstance(request, pdu.WriteCoil | pdu.WriteRegister):
                raise
            from ..maps.writing import cell_requests

            table = "coils" if isinstance(request, pdu.WriteCoil) else "holding_registers"
            for other in cell_requests(table, request.address, [request.value], "multiple"):
                await self.execute(other)

    async def _change_register(self, mask: pdu.MaskWriteRegister, function: WriteFunction) -> None:
        """Change a register as section 6.16 of the specification says: read it, then write it."""
        from ..maps.writing import cell_requests

        async with self._driver.lock:
            (register,) = await self.execute(pdu.ReadHoldingRegisters(mask.address, 1))
            value = register & mask.and_mask | mask.or_mask & ~mask.and_mask
            cells = [value & 0xFFFF]
            for request in cell_requests("holding_registers", mask.address, cells, function):
                await self._write(request, function)


def _values_in(registers: list[int], kind: ValueType, name: str) -> list[Any]:
    """Return the values of registers; raise NoValue with the name of the place if one has none."""
    values = kind.values_in(registers)
    for value in values:
        if isinstance(value, ValueError):
            from ..maps.meaning import no_value

            raise no_value(name, kind, value)
    return values
