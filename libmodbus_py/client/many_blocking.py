# Generated from many_async.py by packaging/generate_blocking.py; do not edit.
"""
The methods of clients that send many requests: together, as request objects or by a plan, and at a
steady pace.

`packaging/generate_blocking.py` makes those of the blocking client of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar, Unpack, overload

from ..protocol.checks import seconds
from ..protocol.errors import ModbusError, alike
from .call import NOT_ASKED, SILENCE, Call, raised
from .functions_blocking import BlockingFunctions
from .keywords import NoOthers, check_plan_options, public_methods, unexpected

# Modules that only some methods need are imported by these.
if TYPE_CHECKING:
    from ..maps.items import (
        AnyItem,
        BitItem,
        FloatItem,
        IntegerItem,
        Items,
        Key,
        NamedValues,
        PlanOptions,
        Strict,
        Tolerant,
        Values,
    )
    from ..maps.plan import Plan
    from ..maps.refusals import Refusals
    from ..maps.register_map import AnyMap
    from ..maps.watched import Pace, PolledValues, WatchedPoints
    from ..protocol import pdu

__all__ = ["BlockingMany"]

Polled = TypeVar("Polled")


@public_methods("Client")
class BlockingMany(BlockingFunctions):
    """The methods that send many requests together, once or at a steady pace."""

    def execute_many(
        self,
        requests: Iterable[pdu.Request[Any]],
        *,
        return_exceptions: bool = False,
        **wrong: Unpack[NoOthers],
    ) -> list[Any]:
        """
        Send many request objects, several reads at a time with `max_in_flight`.

        Up to `max_in_flight` of the client's reads are pending at the same time. A write is alone,
        and the requests keep the order around it in which they are given. The `timeout` of each
        request begins when it is sent. On a blocking client, other threads wait until all requests
        are done; on an `AsyncClient`, requests of other tasks are sent in between.

        With `return_exceptions`, a failure does not stop the remaining requests. If the
        connection is lost, the pending requests fail, and the remaining ones are sent over a new
        connection; if that cannot be established, they fail, too.

        Args:
            requests: request objects of `libmodbus_py.pdu`; all are checked before the
                first is sent.
            return_exceptions: True to return a ModbusError in place of the result of a request
                that failed. False to raise the first of them, in the order of the requests: then
                nothing more is sent, and the responses that are still pending are dropped.

        Returns:
            The results in the order of the requests.

        Raises:
            TypeError, ValueError: a request is wrong; it is named by its index (``requests[3]``).
        """
        if wrong:
            raise unexpected(self.execute_many, wrong)
        return self._run_batch(requests, return_exceptions)

    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, FloatItem], **options: Unpack[Strict]
    ) -> dict[Key, list[float]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, FloatItem], **options: Unpack[Tolerant]
    ) -> NamedValues[Key, list[float]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, BitItem], **options: Unpack[Strict]
    ) -> dict[Key, list[bool]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, BitItem], **options: Unpack[Tolerant]
    ) -> NamedValues[Key, list[bool]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, IntegerItem], **options: Unpack[Strict]
    ) -> dict[Key, list[int]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, IntegerItem], **options: Unpack[Tolerant]
    ) -> NamedValues[Key, list[int]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, AnyItem], **options: Unpack[Strict]
    ) -> dict[Key, Values]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Mapping[Key, AnyItem], **options: Unpack[Tolerant]
    ) -> NamedValues[Key, Values]: ...
    @overload
    def read_many(
        self, items: Iterable[AnyItem], **options: Unpack[Strict]
    ) -> list[Values]: ...
    @overload
    def read_many(
        self, items: Iterable[AnyItem], **options: Unpack[Tolerant]
    ) -> list[Values | ModbusError]: ...
    @overload
    def read_many(self, items: Plan, *, return_exceptions: bool = False) -> Any: ...
    def read_many(
        self,
        items: Plan | Items,
        *,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> Any:
        """
        Read many items with few requests.

        Args:
            items: a `Plan`, or the items of one, such as
                ``{"level": ("holding_registers", 100, 1, "float32"), "valves": ("coils", 0, 8)}``.
            return_exceptions: as for `execute_many`; each item of a failed
                request gets a ModbusError in place of its values. If the first request gets no
                answer, the others are not sent, and fail with the same error: a silent device
                costs one timeout. The next call then begins with another request.
            options: the options of `Plan`, unless `items` is one: `gap`, `forbidden`,
                `max_registers`, `max_bits`.

        Returns:
            A list of values for each item, in the order of the items; a dict by name if `items`
            is a mapping. None stands for data that is no value of the item's type. With
            `return_exceptions`, `good` and `failed` of the dict have the values and the errors.

        Raises:
            TypeError, ValueError: an argument is wrong, as for `Plan`.
            NoValue: all data of an item is no value of its type; with `return_exceptions` it is
                returned in place of the item's values.
            IllegalDataAddress: a merged request covers cells that the device
                lacks. With a `Plan`, the items that the device refuses are found by halving the
                request; with `return_exceptions` they are left out (`unreadable`), otherwise
                the first of them is named in `names` of the error.
        """
        if options:
            check_plan_options(self.read_many, options)
        from ..maps.plan import planned

        plan = planned(items, options)
        if plan is not items:  # what would be learnt of the device would be lost
            answers = self._read_batch(plan.requests, return_exceptions, self._refusals)
            if not return_exceptions:
                raised(answers)
        else:
            answers = self._answers(plan, return_exceptions)
        values = plan.results(answers)
        if not return_exceptions:
            raised(values.values() if isinstance(values, dict) else values)
        return values

    @overload
    def watch(
        self,
        what: AnyMap,
        *,
        every: float,
        names: Iterable[str] | None = None,
        **options: Unpack[PlanOptions],
    ) -> BlockingPolls[PolledValues]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self, what: Mapping[Key, FloatItem], *, every: float, **options: Unpack[PlanOptions]
    ) -> BlockingPolls[NamedValues[Key, list[float]]]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self, what: Mapping[Key, BitItem], *, every: float, **options: Unpack[PlanOptions]
    ) -> BlockingPolls[NamedValues[Key, list[bool]]]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self, what: Mapping[Key, IntegerItem], *, every: float, **options: Unpack[PlanOptions]
    ) -> BlockingPolls[NamedValues[Key, list[int]]]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self, what: Mapping[Key, AnyItem], *, every: float, **options: Unpack[PlanOptions]
    ) -> BlockingPolls[NamedValues[Key, Values]]: ...
    @overload
    def watch(
        self, what: Iterable[AnyItem], *, every: float, **options: Unpack[PlanOptions]
    ) -> BlockingPolls[list[Values | ModbusError]]: ...
    @overload
    def watch(self, what: Plan, *, every: float) -> BlockingPolls[Any]: ...
    def watch(
        self,
        what: AnyMap | Plan | Items,
        *,
        every: float,
        names: Iterable[str] | None = None,
        **options: Unpack[PlanOptions],
    ) -> BlockingPolls[Any]:
        """
        Read the same points or items again and again, at a steady pace.

        ``for values in plc.watch(meter, every=1)``; ``async for`` with an `AsyncClient`.

        The first values are read at once; later polls start at whole multiples of the interval
        after the first one. If the device or the program takes longer than that, the polls that it
        misses are skipped.

        If the device does not answer, the loop goes on: it yields errors in place of values, after
        one timeout (`read_many`), and the client connects again by itself. The loop ends when the
        client is closed, even by another thread or task, and may be left at any time.

        Args:
            what: a `RegisterMap` or the path of its file, a `Plan`, or the items of one, as for
                `read_many`.
            every: seconds from one poll to the next, 0.01..86400. A point with an interval of its
                own (`Point.interval`) is read at that interval instead: polls then come at the
                shortest interval, and points that are not due keep their values.
            names: the names of the points of the map to read; None for all readable points.
            options: the options of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Returns:
            An iterator. For a map, it yields what `read_map` returns with
            ``return_exceptions=True``, in a dict whose attribute `fell` has the names of totals
            (`Point.never_falls`) that are smaller than before, even when they were read a second
            time. Otherwise it yields what `read_many` returns with ``return_exceptions=True``.
            `good` and `failed` of a dict have the values and the errors.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing was sent.
        """
        if options:
            check_plan_options(self.watch, options)
        from ..maps.watched import Pace, watched

        interval = seconds("every", every, 0.01)
        polls = watched(what, names, interval, options)
        return BlockingPolls(
            self,
            Pace(getattr(polls, "interval", interval)),
            lambda at: self._poll(polls, at),
        )

    def _poll(self, what: Plan | WatchedPoints, at: float) -> Any:
        """Read the due points at a time; a failed one has the reason in place of its value."""
        from ..maps.plan import Plan
        from ..maps.watched import polled

        if isinstance(what, Plan):
            return polled(what, self._answers(what, True))
        polls = what.poll(at)
        plan = next(polls)
        while True:
            values = polled(plan, self._answers(plan, True))
            try:
                plan = polls.send(values)
            except StopIteration as done:
                return done.value

    def _run_batch(
        self, requests: Iterable[pdu.Request[Any]], return_exceptions: bool
    ) -> list[Any]:
        """Send requests together, as `execute_many` does."""
        batch = self._batch(requests, return_exceptions)
        outcomes: list[Any] = self._driver.run(batch)
        raised(outcomes, (ModbusError,) if return_exceptions else ())
        return outcomes

    def _read_batch(
        self, requests: Iterable[pdu.Request[Any]], return_exceptions: bool, refusals: Refusals
    ) -> list[Any]:
        """
        Send reads together; return their results, and ModbusErrors in place of some.

        Nothing is sent after the first failure; with `return_exceptions`, only if nothing was
        answered: then all fail, and the next reads of a unit begin with another one.
        """
        reads = list(requests)
        first = refusals.first % len(reads) if return_exceptions and reads else 0
        batch = self._batch(reads[first:] + reads[:first], return_exceptions, is_poll=True)
        outcomes: list[Any] = self._driver.run(batch)
        raised(outcomes, (ModbusError,))
        if return_exceptions and NOT_ASKED in outcomes:
            refusals.first += 1
            silence = next(outcome for outcome in outcomes if isinstance(outcome, SILENCE))
            outcomes = [_given_up(call, silence) for call in batch.calls]
        last = len(reads) - first
        return outcomes[last:] + outcomes[:last]

    def _answers(self, plan: Plan, return_exceptions: bool) -> list[Any]:
        """Return the answers to a plan's requests, for its `results`; or raise the first error."""
        from ..maps.refusals import is_refusal, reading

        refusals = self._refusals
        answers: list[Any] = []
        if not refusals:
            answers = self._read_batch(plan.requests, return_exceptions, refusals)
        if refusals or any(map(is_refusal, answers)):
            steps = reading(
                plan.blocks,
                refusals,
                self._driver.now(),
                self.statistics.connects,
                is_strict=not return_exceptions,
                tell=self._log_refusal,
            )
            try:
                requests = next(steps)
                # Another thread, or task, may have learnt something meanwhile.
                outcomes = answers if requests == list(plan.requests) else None
                while True:
                    if not outcomes:
                        outcomes = self._read_batch(requests, return_exceptions, refusals)
                    requests, outcomes = steps.send(outcomes), None
            except StopIteration as done:
                answers = done.value
            finally:
                steps.close()
        if not return_exceptions:
            raised(answers)
        return answers


def _given_up(call: Call, silence: ModbusError) -> ModbusError:
    """Return the outcome of a read of a device of which the first read was not answered."""
    if call.outcome is not NOT_ASKED:
        outcome: ModbusError = call.outcome
        return outcome
    error = alike(silence)
    error.args = (f"given up after {silence.asked}: {silence.args[0]}",)
    error.function, error.asked, error.sent = call.function, str(call.request), call.adu
    return error


# --- at a steady pace -----------------------------------------------------------------------


class BlockingPolls(Generic[Polled]):
    """
    An endless iterator over the values of a device, made by `watch`.

    It ends when the client is closed, which of a blocking client any thread and signal handlers may
    do. It holds no resources between two values, so that a loop over it may be left at any time;
    waiting for the next values may be cancelled and started again.
    """

    def __init__(self, client: BlockingMany, pace: Pace, poll: Callable[[float], Any]) -> None:
        self._client = client
        self._pace = pace
        self._poll = poll

    def __iter__(self) -> BlockingPolls[Polled]:
        return self

    def __next__(self) -> Polled:
        client = self._client
        due = self._pace.due(client._driver.now())
        if not client._driver.wait_until(due):
            raise StopIteration
        self._pace.begin(due)
        values: Polled = self._poll(due)
        if client.closed:
            raise StopIteration
        return values
