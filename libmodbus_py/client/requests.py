"""
Every method of both clients, once.

A method makes a request (`asks`), or is a procedure that yields requests, one or `Several`,
and is sent results (`follows`). A blocking client carries it out at once; an awaiting one
returns a coroutine.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from functools import update_wrapper
from typing import (
    TYPE_CHECKING,
    Any,
    Concatenate,
    Generic,
    ParamSpec,
    TypeVar,
    Unpack,
    overload,
)

from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import IllegalFunction, ModbusError
from .procedures import ChangeRegister, Several, Steps

__all__ = ["Awaiting", "Blocking", "Requests", "Several", "Steps"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


# What only some methods need is imported by them.
if TYPE_CHECKING:
    from ..maps.plan import Items, Plan, PlanOptions
    from ..maps.register_map import RegisterMap
    from ..maps.watched import WatchedPoints
    from ..protocol.tables import RegisterTable, WritableTable
    from ..protocol.type_names import Layout, Order, TextOptions, TypeName
    from .typed_values import ReadOne, ReadSeveral

    class _Method(Generic[Arguments, Result]):
        """A method of both clients, for type checkers: returns a result, or one to await."""

        @overload
        def __get__(self, client: Blocking, owner: object) -> Callable[Arguments, Result]: ...
        @overload
        def __get__(
            self, client: Awaiting, owner: object
        ) -> Callable[Arguments, Coroutine[Any, Any, Result]]: ...
        @overload
        def __get__(self, client: None, owner: object) -> Callable[..., Any]: ...
        def __get__(self, client: Any, owner: object) -> Any: ...

    def asks(
        make: Callable[Concatenate[Any, Arguments], pdu.Request[Result]],
    ) -> _Method[Arguments, Result]: ...

    def follows(
        make: Callable[Concatenate[Any, Arguments], Steps[Result]],
    ) -> _Method[Arguments, Result]: ...

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

    def one_by_type(method: object) -> OneByType: ...

    def several_by_type(method: object) -> SeveralByType: ...

else:
    # The types are for checkers: nothing else is to be known of them.
    def one_by_type(method):
        return method

    several_by_type = one_by_type

    # Plain functions, so that help() and inspect.signature() work.

    def asks(make):
        def method(self, /, *arguments, **named):
            try:
                request = make(self, *arguments, **named)
            except (TypeError, ValueError) as error:
                return self._refuse(error)
            return self.execute(request)

        return _dressed(method, make)

    def follows(make):
        def method(self, /, *arguments, **named):
            return self._follow(make, arguments, named)

        return _dressed(method, make)

    def _dressed(method, make):
        """As the method is told of: with its result, not with what is made on the way."""
        told = make.__annotations__["return"]
        make.__annotations__["return"] = told.partition("[")[2].removesuffix("]")
        method.__annotations__ = make.__annotations__
        return update_wrapper(method, make)


class Requests:
    """One method for each function; addresses are 0-based, 0..65535."""

    @asks
    def read_coils(self, address: int, count: int) -> pdu.Request[list[bool]]:
        """Read 1..2000 coils (function 1, modbus_read_bits)."""
        return pdu.ReadCoils(address, count)

    @asks
    def read_discrete_inputs(self, address: int, count: int) -> pdu.Request[list[bool]]:
        """Read 1..2000 discrete inputs (function 2, modbus_read_input_bits)."""
        return pdu.ReadDiscreteInputs(address, count)

    @asks
    def read_holding_registers(self, address: int, count: int) -> pdu.Request[list[int]]:
        """Read 1..125 holding registers (function 3, modbus_read_registers)."""
        return pdu.ReadHoldingRegisters(address, count)

    @asks
    def read_input_registers(self, address: int, count: int) -> pdu.Request[list[int]]:
        """Read 1..125 input registers (function 4, modbus_read_input_registers)."""
        return pdu.ReadInputRegisters(address, count)

    @asks
    def write_coil(self, address: int, value: bool) -> pdu.Request[None]:
        """Write one coil (function 5, modbus_write_bit)."""
        return pdu.WriteCoil(address, value)

    @asks
    def write_register(self, address: int, value: int) -> pdu.Request[None]:
        """Write one holding register, 0..65535 (function 6, modbus_write_register)."""
        return pdu.WriteRegister(address, value)

    @asks
    def write_coils(self, address: int, values: Iterable[bool]) -> pdu.Request[None]:
        """Write 1..1968 coils (function 15, modbus_write_bits)."""
        return pdu.WriteCoils(address, values)  # type: ignore[arg-type]

    @asks
    def write_registers(self, address: int, values: Iterable[int]) -> pdu.Request[None]:
        """Write 1..123 holding registers, each 0..65535 (function 16, modbus_write_registers)."""
        return pdu.WriteRegisters(address, values)  # type: ignore[arg-type]

    @asks
    def mask_write_register(self, address: int, and_mask: int, or_mask: int) -> pdu.Request[None]:
        """
        Set a holding register to (current AND and_mask) OR (or_mask AND NOT and_mask).

        Function 22, modbus_mask_write_register; both masks are 0..65535.
        """
        return pdu.MaskWriteRegister(address, and_mask, or_mask)

    @asks
    def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, values: Iterable[int]
    ) -> pdu.Request[list[int]]:
        """
        Write 1..121 holding registers, then read 1..125.

        Function 23, modbus_write_and_read_registers.
        """
        return pdu.ReadWriteRegisters(read_address, read_count, write_address, values)  # type: ignore[arg-type]

    @asks
    def read_exception_status(self) -> pdu.Request[int]:
        """Read the eight exception status outputs, lowest in bit 0 (function 7)."""
        return pdu.ReadExceptionStatus()

    @follows
    def diagnostics(self, sub_function: int, data: int = 0) -> Steps[int]:
        """
        Run a diagnostic sub-function (function 8).

        Args:
            sub_function: 0..65535; `pdu.SubFunction` names those of the specification.
            data: 0..65535; FF00h makes sub-function 1 (restart) clear the event log, too, and
                sub-function 3 expects the new ASCII delimiter in the high byte.

        Returns:
            The data of the response; `data` itself for sub-function 4 (force listen only), which
            gets no response. `execute(pdu.Diagnostics(0, data))` echoes up to 250 bytes.
        """
        word = integer("data", data, 0, 0xFFFF).to_bytes(2, "big")
        answer = yield pdu.Diagnostics(sub_function, word)
        return data if answer is None else int.from_bytes(answer, "big")

    @asks
    def read_comm_event_counter(self) -> pdu.Request[pdu.CommEventCounter]:
        """Read the status word and the event counter (function 11)."""
        return pdu.ReadCommEventCounter()

    @asks
    def read_comm_event_log(self) -> pdu.Request[pdu.CommEventLog]:
        """Read the counters and up to 64 events, newest first (function 12)."""
        return pdu.ReadCommEventLog()

    @asks
    def report_server_id(self) -> pdu.Request[pdu.ServerId]:
        """
        Read the identifier and the run status of the device (function 17, modbus_report_slave_id).

        Returns:
            The response, split after an identifier of one byte; use
            ``pdu.ServerId.split(result.data, length)`` for a device whose identifier is longer.
        """
        return pdu.ReportServerId()

    @asks
    def read_file_records(
        self, records: Sequence[tuple[int, int, int]]
    ) -> pdu.Request[list[list[int]]]:
        """
        Read records of files (function 20, which libmodbus lacks).

        Args:
            records: 1..35 tuples (file 1..65535, first record 0..9999, number of records
                1..124). All records together must fit into one response.

        Returns:
            For each tuple the list of its records, 0..65535 each.
        """
        return pdu.ReadFileRecords(records)  # type: ignore[arg-type]

    @asks
    def write_file_records(
        self, records: Sequence[tuple[int, int, Iterable[int]]]
    ) -> pdu.Request[None]:
        """
        Write records of files (function 21, which libmodbus lacks).

        Args:
            records: tuples (file 1..65535, first record 0..9999, values), with 1..122 values of
                0..65535 each. All of them must fit into one request.
        """
        return pdu.WriteFileRecords(records)  # type: ignore[arg-type]

    @asks
    def read_fifo_queue(self, address: int) -> pdu.Request[list[int]]:
        """Read the 0..31 registers of a FIFO queue without removing them (function 24)."""
        return pdu.ReadFifoQueue(address)

    @follows
    def read_device_identification(
        self, level: str | int = "basic"
    ) -> Steps[pdu.DeviceIdentification]:
        """
        Read the identification of a device (function 43/14), with as many requests as needed.

        Args:
            level: "basic", "regular" or "extended"; or the id of a single object, 0..255.

        Returns:
            The objects that the device sent; its `complete` is False if some of them are missing.

        Raises:
            InvalidResponse: the device sends the same objects again and again, or fewer than it
                announced, and one of the three mandatory objects is missing.
        """
        from ..protocol.pdu.interface import identify

        return (yield from identify(level))

    @asks
    def encapsulated_transport(self, mei_type: int, data: bytes) -> pdu.Request[bytes]:
        """
        Send up to 251 bytes to an encapsulated interface (function 43).

        Args:
            mei_type: 0..255; 13 is CANopen.
            data: the bytes after the MEI type; they are sent unchanged.

        Returns:
            The bytes after the MEI type of the response.
        """
        return pdu.EncapsulatedTransport(mei_type, data)

    # --- many at once ----------------------------------------------------------------

    @follows
    def execute_many(
        self,
        requests: Iterable[pdu.Request[Any]],
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> Steps[list[Any]]:
        """
        Send many request objects, several at a time if frames carry transaction ids.

        With the framings "tcp" and "udp", up to `max_in_flight` of these requests are pending at
        the same time, within the client's own `max_in_flight`, which applies to all its requests
        together. The `timeout` of each request begins when it is sent. On a blocking client,
        other threads wait until all requests are done; on an `AsyncClient`, requests of other
        tasks are sent in between. A server may execute the requests in any order, so writes that
        depend on each other need ``max_in_flight=1``. Requests are sent one after the other with
        ``max_in_flight=1``, with all other framings, and if one of them gets no response.

        With `return_exceptions`, a failure does not stop the remaining requests. If the
        connection is lost, the pending requests fail, and the remaining ones are sent over a new
        connection; if that cannot be established, they fail, too.

        A request that is repeated (`retries`, `busy_retries`) counts as pending all the
        time, so that no other request overtakes it with ``max_in_flight=1``.

        Args:
            requests: request objects of `libmodbus_py.pdu`; all are checked before the
                first is sent.
            max_in_flight: 1..256; servers need not accept more than 16 (TCP guide,
                section 4.3).
            return_exceptions: True to return a ModbusError in place of the result of a request
                that failed. False to raise the first of them, in the order of the requests: then
                nothing more is sent, and the responses that are still pending are dropped.

        Returns:
            The results in the order of the requests.

        Raises:
            TypeError, ValueError: `max_in_flight` or a request is wrong; a request is named
                by its index (``requests[3]``).
        """
        answers: list[Any] = yield Several(requests, max_in_flight, return_exceptions)
        return answers

    @follows
    def _read_many(
        self,
        items: Plan | Items,
        max_in_flight: int,
        return_exceptions: bool,
        options: PlanOptions,
    ) -> Steps[Any]:
        """As of `read_many` of the clients, whose types depend on what is given."""
        from ..maps.plan import planned

        plan = planned(items, options)
        if plan is not items:  # what would be learnt of the device would be lost
            answers = yield Several(plan.requests, max_in_flight, return_exceptions)
            return plan.results(answers)
        from .plan_reading import plan_answers

        answers = yield from plan_answers(
            self,  # type: ignore[arg-type]  # as part of a client it is a handle, too
            plan,
            max_in_flight,
            return_exceptions,
        )
        return plan.results(answers)

    @follows
    def _poll(self, what: Plan | WatchedPoints, max_in_flight: int, at: float) -> Steps[Any]:
        """Read what is due at a time; what fails gets the reason in place of its values."""
        from ..maps.plan import Plan

        if isinstance(what, Plan):
            return (yield from self._poll_plan(what, max_in_flight))
        polls = what.poll(at)
        plan = next(polls)
        while True:
            found = yield from self._poll_plan(plan, max_in_flight)
            try:
                plan = polls.send(found)
            except StopIteration as done:
                return done.value

    def _poll_plan(self, plan: Plan, max_in_flight: int) -> Steps[Any]:
        from ..maps.register_map import PointPlan
        from .plan_reading import plan_answers

        answers = yield from plan_answers(
            self,  # type: ignore[arg-type]  # as part of a client it is a handle, too
            plan,
            max_in_flight,
            True,
        )
        if isinstance(plan, PointPlan):
            return plan.results(answers, return_exceptions=True)
        return plan.results(answers)

    # --- values ----------------------------------------------------------------------

    @one_by_type
    @follows
    def read_value(
        self, /, table: RegisterTable, address: int, type: TypeName, **layout: Unpack[Layout]
    ) -> Steps[Any]:
        """
        Read one number, string, time or list of bits from registers.

        Args:
            table: "holding_registers" or "input_registers".
            address: the address of the first register.
            type: the type of the value, such as "float32"; see `libmodbus_py.values`.
            layout: `order` (ABCD, CDAB, BADC or DCBA); `encoding` and `padding` of strings.

        Raises:
            TypeError, ValueError: an argument is wrong, or the registers hold no such value.
        """
        from ..protocol.tables import TABLES
        from ..protocol.values import value_type

        kind = value_type(type, **layout)
        cells = yield TABLES[_registers(table)].read(address, kind.registers)
        return kind.decode(cells)

    @several_by_type
    @follows
    def read_values(
        self,
        /,
        table: RegisterTable,
        address: int,
        type: TypeName,
        count: int = 1,
        *,
        order: Order = "ABCD",
        **text: Unpack[TextOptions],
    ) -> Steps[list[Any]]:
        """
        Read values of one type from consecutive registers, with one request.

        Args:
            table: "holding_registers" or "input_registers".
            address: the address of the first register.
            type: the type of the values, such as "float32"; see `libmodbus_py.values`.
            count: the number of values, 1 or more; they take up to 125 registers.
            order: ABCD, CDAB, BADC or DCBA.
            text: `encoding` and `padding` of strings.

        Raises:
            TypeError, ValueError: an argument is wrong, or the registers hold no such values.
        """
        from ..protocol.tables import TABLES
        from ..protocol.values import value_type

        table = _registers(table)
        kind = value_type(type, order=order, **text)
        registers = kind.registers * integer("count", count, 1, 125 // kind.registers)
        cells = yield TABLES[table].read(address, registers)
        return kind.decode_many(cells)

    @follows
    def write_values(
        self,
        /,
        table: WritableTable,
        address: int,
        values: Iterable[Any],
        type: TypeName,
        *,
        order: Order = "ABCD",
        **text: Unpack[TextOptions],
    ) -> Steps[None]:
        """
        Write values of one type to consecutive holding registers, with one request.

        Args:
            table: "holding_registers", the only table of registers that can be written.
            address: the address of the first register.
            values: one or more values, which take up to 123 registers.
            type, order, text: as for `read_values`.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing was sent.
        """
        from ..protocol.words import table_named

        if table != "holding_registers" and table_named(table) != "holding_registers":
            raise ValueError(f"table must be holding_registers, not {table!r}")
        from ..protocol.values import value_type

        cells = value_type(type, order=order, **text).encode_many(values)
        yield pdu.WriteRegisters(address, cells)  # type: ignore[arg-type]

    # --- register maps ------------------------------------------------------------------

    @follows
    def read_map(
        self,
        map: RegisterMap,
        names: Iterable[str] | None = None,
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> Steps[dict[str, Any]]:
        """
        Read points of a register map with few requests.

        Points that touch or overlap share a request; cells between points are only read if `gap`
        allows it. A device refuses a whole request because of a single cell that it lacks. The
        points that it refuses are found once, by halving the request. With `return_exceptions`
        they are then left out (`unreadable` lists them), and tried again, one at each call, after
        ten minutes and after a new connection. Without it, the refusal of the first of these
        points is raised, with the name of the point in `names`.

        Args:
            map: the register map, such as `load_map` returns.
            names: the names of the points to read; None for all readable points. A program that
                often reads the same few points should make a `RegisterMap` of them.
            max_in_flight: as for `execute_many`.
            return_exceptions: True to return, in place of a value, a ModbusError if the point
                could not be read, a ValueError if its registers hold no value of its type, and a
                `NoValue` with the reason where there is no value. False to raise the first
                ModbusError or ValueError, and to return None where there is no value.
            options: the options of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Returns:
            The scaled values by name, as `Point.decode` returns them; None if the device reports
            that there is no value, or if the value is not plausible.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be read; an option is wrong;
                registers hold no value of the point's type.
        """
        plan = _checked_map(map).plan(names, **options)
        from .plan_reading import plan_answers

        answers = yield from plan_answers(
            self,  # type: ignore[arg-type]  # as part of a client it is a handle, too
            plan,
            max_in_flight,
            return_exceptions,
        )
        return plan.results(answers, return_exceptions=return_exceptions)

    @follows
    def write_map(
        self, map: RegisterMap, values: Mapping[str, Any], *, multiple: bool = False
    ) -> Steps[None]:
        """
        Write values to points of a register map.

        Names, access, types and ranges are all checked before the first byte is sent. Requests
        are sent in the order of the map, and adjacent points share one. If a request fails, its
        error is raised, and the requests after it are not sent.

        Points with `scale_from` are written with the factor that the device has at that time: the
        points that hold the factors are read first. Parts of registers are written with function 22
        (mask write register). If the device lacks that function, the register is read, changed and
        written, and no other such change on this connection comes in between.

        Args:
            map: the register map, such as `load_map` returns.
            values: the values by name, such as ``{"setpoint": 21.5}``; each is rounded to the
                nearest value that its scale can represent (`Point.encode`).
            multiple: True to write even single coils and registers with functions 15 and
                16, for devices that lack functions 5 and 6.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; a value does
                not fit its point; points share cells.
            NoValue: a point named by `scale_from` has no value that can be a scale.
        """
        points = _checked_map(map)
        sources = points.scale_sources(values)
        read: dict[str, Any] = {}
        if sources:
            plan = points.plan(sources)
            answers = yield Several(plan.requests, 1, False)
            read = plan.results(answers)
        lacks_masks = False
        for request in points.writes(values, multiple=multiple, sources=read):
            if not isinstance(request, pdu.MaskWriteRegister):
                yield request
                continue
            if not lacks_masks:
                (outcome,) = yield Several([request], 1, True)
                lacks_masks = isinstance(outcome, IllegalFunction)
                if isinstance(outcome, ModbusError) and not lacks_masks:
                    raise outcome
            if lacks_masks:
                yield ChangeRegister(request)


def _registers(table: object) -> Any:
    """Return the name of a table of registers, which may be written as vendors do."""
    from ..protocol.tables import REGISTER_TABLES
    from ..protocol.words import TABLE_WORDS, close_word, table_named

    if table in REGISTER_TABLES:
        return table
    name = table_named(table)
    if name not in REGISTER_TABLES:
        words = [word for word, meaning in TABLE_WORDS.items() if meaning in REGISTER_TABLES]
        close = close_word(table, REGISTER_TABLES, words)
        wanted = ", ".join(REGISTER_TABLES)
        raise ValueError(f"table must be one of {wanted}, not {table!r}{close}")
    return name


def _checked_map(given: object) -> RegisterMap:
    # Who has one has paid for the import; others should not.
    from ..maps.register_map import RegisterMap

    if not isinstance(given, RegisterMap):
        raise TypeError(f"map must be a RegisterMap, not {type(given).__name__}")
    return given


class Blocking(Requests):
    """A client whose methods return results."""

    def _refuse(self, error: Exception) -> Any:
        raise error

    def _follow(self, make: Any, arguments: Any, named: Any) -> Any:
        raise NotImplementedError


class Awaiting(Requests):
    """A client whose methods return coroutines."""

    async def _refuse(self, error: Exception) -> Any:
        raise error

    async def _follow(self, make: Any, arguments: Any, named: Any) -> Any:
        raise NotImplementedError
