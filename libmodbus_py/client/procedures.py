"""
The methods of both clients that may take several requests: many at once, plans, typed values, maps.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import IllegalFunction, ModbusError
from .requests import CONNECT, LOCK, Requests, Several, Steps, follows, one_by_type, several_by_type

__all__ = ["Procedures"]

# What only some methods need is imported by them.
if TYPE_CHECKING:
    from ..maps.plan import Items, Plan, PlanOptions
    from ..maps.register_map import AnyMap
    from ..maps.watched import WatchedPoints
    from ..protocol.tables import RegisterTable, WritableTable
    from ..protocol.words import Layout, Order, TextOptions, TypeName


class Procedures(Requests):
    """The methods that may take several requests; addresses are 0-based, 0..65535."""

    @follows
    def connect(self) -> Steps[None]:
        """
        Connect, unless the client is connected. Requests connect by themselves if necessary.

        Raises:
            ModbusConnectionError: the connection could not be established, with errno; or the
                client is closed.
            RuntimeError: an `AsyncClient` belongs to another event loop.
        """
        yield CONNECT

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
        self, items: Plan | Items, max_in_flight: int, return_exceptions: bool, options: PlanOptions
    ) -> Steps[Any]:
        """As of `read_many` of the clients, whose types depend on what is given."""
        from ..maps.plan import planned

        plan = planned(items, options)
        if plan is not items:  # what would be learnt of the device would be lost
            answers = yield Several(plan.requests, max_in_flight, return_exceptions)
            return plan.results(answers)
        answers = yield from _plan_answers(self, plan, max_in_flight, return_exceptions)
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
        from ..maps.point_plan import PointPlan

        answers = yield from _plan_answers(self, plan, max_in_flight, True)
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
    def write_value(
        self,
        /,
        table: WritableTable,
        address: int,
        value: Any,
        type: TypeName,
        **layout: Unpack[Layout],
    ) -> Steps[None]:
        """
        Write one number, string, time or list of bits to holding registers, with function 16.

        Args:
            table: "holding_registers", the only table of registers that can be written.
            address: the address of the first register.
            value: the value, as `read_value` returns it.
            type, layout: as for `read_value`.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing was sent.
        """
        from ..protocol.values import value_type

        _check_writable(table)
        cells = value_type(type, **layout).encode(value)
        yield pdu.WriteRegisters(address, cells)  # type: ignore[arg-type]

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
        from ..protocol.values import value_type

        _check_writable(table)
        cells = value_type(type, order=order, **text).encode_many(values)
        yield pdu.WriteRegisters(address, cells)  # type: ignore[arg-type]

    # --- register maps ------------------------------------------------------------------

    @follows
    def read_map(
        self,
        map: AnyMap,
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
            map: the register map, such as `load_map` returns; or the path of its file, which is
                then loaded at each call.
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
            MapError: as for `load_map`.
        """
        from ..maps.register_map import map_of

        plan = map_of(map).plan(names, **options)
        answers = yield from _plan_answers(self, plan, max_in_flight, return_exceptions)
        return plan.results(answers, return_exceptions=return_exceptions)

    @follows
    def write_map(
        self, map: AnyMap, values: Mapping[str, Any], *, multiple: bool = False
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
            map: the register map, or the path of its file, as for `read_map`.
            values: the values by name, such as ``{"setpoint": 21.5}``; each is rounded to the
                nearest value that its scale can represent (`Point.encode`).
            multiple: True to write even single coils and registers with functions 15 and
                16, for devices that lack functions 5 and 6.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; a value does
                not fit its point; points share cells.
            MapError: as for `load_map`.
            NoValue: a point named by `scale_from` has no value that can be a scale.
        """
        from ..maps.register_map import map_of

        points = map_of(map)
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
                    yield LOCK
            if lacks_masks:  # section 6.16 of the specification says what is written
                (register,) = yield pdu.ReadHoldingRegisters(request.address, 1)
                value = register & request.and_mask | request.or_mask & ~request.and_mask
                yield pdu.WriteRegister(request.address, value & 0xFFFF)


def _registers(table: object) -> Any:
    """Return the name of a table of registers, which may be written as vendors do."""
    from ..protocol.tables import REGISTER_TABLES
    from ..protocol.words import TABLE_WORDS, close_word, table_named

    name = table_named(table)
    if name not in REGISTER_TABLES:
        words = [word for word, meaning in TABLE_WORDS.items() if meaning in REGISTER_TABLES]
        close = close_word(table, REGISTER_TABLES, words)
        wanted = ", ".join(REGISTER_TABLES)
        raise ValueError(f"table must be one of {wanted}, not {table!r}{close}")
    return name


def _check_writable(table: object) -> None:
    from ..protocol.words import table_named

    if table != "holding_registers" and table_named(table) != "holding_registers":
        raise ValueError(f"table must be holding_registers, not {table!r}")


def _plan_answers(
    client: Any, plan: Plan, max_in_flight: int, return_exceptions: bool
) -> Steps[list[Any]]:
    """Return the answers to a plan's requests, for `Plan.results`; or raise the first error."""
    from ..maps.holes import is_refusal, reading
    from ..protocol.logs import HarmlessLogger

    holes = client.holes
    answers: list[Any] = []
    if not holes:
        answers = yield Several(plan.requests, max_in_flight, return_exceptions, True)
    if holes or any(map(is_refusal, answers)):
        now, connects = client.now(), client.statistics.connects
        steps = reading(
            plan.blocks,
            holes,
            now,
            connects,
            is_strict=not return_exceptions,
            tell=partial(HarmlessLogger(__name__).info, "%s: cannot be read: %s", client.device),
        )
        try:
            requests = next(steps)
            # Another thread, or task, may have learnt something meanwhile.
            outcomes = answers if requests == list(plan.requests) else None
            while True:
                if not outcomes:
                    outcomes = yield Several(requests, max_in_flight, return_exceptions, True)
                requests, outcomes = steps.send(outcomes), None
        except StopIteration as done:
            answers = done.value
    if not return_exceptions:
        for each in answers:
            if isinstance(each, ModbusError):
                raise each
    return answers
