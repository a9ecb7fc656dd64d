"""
The asyncio client.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Self, TypeVar, Unpack, overload

from ..maps.plan import (
    Item,
    Items,
    Key,
    Named,
    Plan,
    PlanOptions,
    Strict,
    Tolerant,
    Values,
)
from ..maps.register_map import RegisterMap
from ..maps.watched import PolledValues
from ..ports.endpoint import parse
from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import InvalidResponse, ModbusError
from .asyncio_driver import AsyncioDriver
from .batch import MAX_IN_FLIGHT, Batch, encoded, raised
from .handle import Handle
from .options import AsyncOptions, CheckedOptions, assembled
from .polling import AwaitedPolls, interval_of, watched
from .procedures import ChangeRegister, Several
from .requests import Awaiting

__all__ = ["IN_FLIGHT", "MAX_PAUSE", "AsyncClient", "Submitted"]

Result = TypeVar("Result")

MAX_PAUSE = 30.0
IN_FLIGHT = 16


class AsyncClient(Handle[AsyncioDriver], Awaiting):
    """
    A client of one unit, for asyncio: `Context` with ``await``.

    Connects when entered (``async with``) or used, again on the next request after the
    connection was lost or counts as dead, and closes on exit. All who wait for a
    connection share one attempt and its failure. The next one comes 0.1 s later,
    then 0.2 s, and so on up to `max_pause`, somewhat less at random, until an answer came;
    a request that cannot wait so long fails at once.

    On "tcp" and "udp" up to `max_in_flight` requests wait for their answers together,
    which come in any order. On serial lines, and these over TCP, it is one request
    at a time, and after a failure the line must be silent for `timeout` before the same unit
    is asked again: an answer that is still to come would be taken for its own. Requests
    get a slot in the order in which they were made.

    A request may be cancelled at any time, by ``asyncio.timeout`` for one. Its answer is
    dropped when it comes, and the others notice nothing.

    A client belongs to the event loop that uses it first, and to one thread. One that was
    not closed issues a ResourceWarning, and closes, when it is garbage collected.

    Every request raises, apart from what its method names:

    * TypeError, ValueError: an argument, named with its range; nothing was sent.
    * ExceptionResponse: the server refused; the subclass says why.
    * ModbusTimeoutError: no complete answer within `timeout`.
    * ModbusConnectionError: no connection, or it was lost meanwhile, with errno.
    * FrameError, InvalidResponse: the answer was none.
    * RuntimeError: another event loop.

    Args:
        url: where, such as "tcp://192.0.2.10?unit=17", "rtu:///dev/ttyUSB0?baudrate=9600"
            (`libmodbus_py.ports.endpoint`).
        options: `unit`, `timeout` and others, which win over those of the URL; see
            `client.options.Options`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(self, url: str, **options: Unpack[AsyncOptions]) -> None:
        endpoint = parse(url)
        settings = CheckedOptions.of(endpoint, options, max_pause=MAX_PAUSE, may_send=None)
        parts = assembled(endpoint, settings, IN_FLIGHT)
        timeouts = settings.timeouts
        is_paced = settings.request_spacing or settings.connect_delay
        is_simple = endpoint.framing != "ascii" and not endpoint.is_serial
        driver = AsyncioDriver(parts, is_simple and not is_paced and settings.may_send is None)
        super().__init__(parts, settings, driver, timeouts)
        self._matching = parts.matching
        self._life = _Life(self._driver)

    async def connect(self) -> None:
        """
        Connect, unless connected. Requests do so by themselves.

        Raises:
            ModbusConnectionError: with errno.
            RuntimeError: another event loop.
        """
        batch = Batch(self.unit, [], self._timeouts)
        await self._driver.run(batch)
        if batch.refusal is not None:
            raise batch.refusal

    async def close(self) -> None:
        """
        Close for good; requests in flight fail at once. May be called any number of times.

        Raises:
            RuntimeError: another event loop.
        """
        await self._driver.close()

    def abandon(self) -> None:
        """
        In a forked child: close its descriptors, with no effect on the parent's connection.

        Every child does this when it is forked; nothing is left to do.
        """
        self._driver.abandon()

    async def __aenter__(self) -> Self:
        try:
            await self.connect()
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def execute(
        self,
        request: pdu.Request[Result],
        *,
        timeout: float | None = None,
        retries: int | None = None,
    ) -> Result:
        timeouts = self._timeouts
        if timeout is not None or retries is not None:
            timeouts = timeouts.but(timeout, retries)
        is_broadcast = self._has_broadcast and self._unit == 0
        pdus = [encoded(request, "request", 0, is_broadcast)]
        batch = Batch(self._unit, [request], timeouts, is_broadcast=is_broadcast, pdus=pdus)
        await self._driver.run(batch)
        result: Result = batch.outcomes[0]
        if isinstance(result, BaseException):
            raise result
        return result

    def submit(
        self, unit: int, request: pdu.Request[Any], on_done: Callable[[], object]
    ) -> Submitted:
        """
        Send a request, and do not wait: for programs that forward thousands of requests, because a
        task for each would be expensive.

        Args:
            unit: 0..255, the unit of the request.
            request: any object of `libmodbus_py.pdu`.
            on_done: called once when the outcome is known, perhaps before this method returns.
                It must not block. What it raises is logged.

        Raises:
            TypeError, ValueError: the request cannot be sent.
            RuntimeError: another event loop.
        """
        if type(unit) is not int or not 0 <= unit <= 255:
            unit = integer("unit", unit, 0, 255)
        is_broadcast = unit == 0 and self._has_broadcast
        pdus = [encoded(request, "request", 0, is_broadcast)]
        batch = Batch(unit, [request], self._timeouts, is_broadcast=is_broadcast, pdus=pdus)
        self._driver.ask(batch, on_done)
        return Submitted(batch, self._driver)

    @property
    def has_ids(self) -> bool:
        """True if frames carry transaction ids: any unit may be asked at any time."""
        return self._matching.has_ids

    @property
    def room(self) -> int:
        """
        The most requests to submit together now: `max_in_flight`, or 0 for a while.

        It is 0 while a request that was lost beside others is asked again alone: others that are
        submitted meanwhile are sent behind it, whatever its answer says about their unit.
        """
        return self._conversation.room

    def ready_at(self, unit: int) -> float:
        """
        Return when a unit may be asked, in the time of the event loop; 0.0 if at once.

        On a line a unit is left alone for one `timeout` after a failure, because nothing tells its
        late answer from the next one. A request that is submitted earlier waits for that, and all
        others with it.

        Args:
            unit: 0..255.
        """
        return self._matching.ready_at(unit)

    @overload
    async def read_many(  # type: ignore[overload-overlap]  # mappings first
        self, items: Named[Key], **options: Unpack[Strict]
    ) -> dict[Key, Values]: ...
    @overload
    async def read_many(  # type: ignore[overload-overlap]
        self, items: Named[Key], **options: Unpack[Tolerant]
    ) -> dict[Key, Values | ModbusError]: ...
    @overload
    async def read_many(self, items: Iterable[Item], **options: Unpack[Strict]) -> list[Values]: ...
    @overload
    async def read_many(
        self, items: Iterable[Item], **options: Unpack[Tolerant]
    ) -> list[Values | ModbusError]: ...
    @overload
    async def read_many(
        self, items: Plan, *, max_in_flight: int = 16, return_exceptions: bool = False
    ) -> Any: ...
    async def read_many(
        self,
        items: Plan | Items,
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> Any:
        return await self._read_many(items, max_in_flight, return_exceptions, options)

    @overload
    def watch(
        self,
        what: RegisterMap,
        *,
        every: float,
        names: Iterable[str] | None = None,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> AwaitedPolls[PolledValues]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self,
        what: Named[Key],
        *,
        every: float,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> AwaitedPolls[dict[Key, Values | ModbusError]]: ...
    @overload
    def watch(
        self,
        what: Iterable[Item],
        *,
        every: float,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> AwaitedPolls[list[Values | ModbusError]]: ...
    @overload
    def watch(self, what: Plan, *, every: float, max_in_flight: int = 16) -> AwaitedPolls[Any]: ...
    def watch(
        self,
        what: RegisterMap | Plan | Items,
        *,
        every: float,
        names: Iterable[str] | None = None,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> AwaitedPolls[Any]:
        interval = seconds("every", every, 0.01)
        polled = watched(what, names, interval, options)
        integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        return AwaitedPolls(
            interval_of(polled, interval),
            lambda at: self._poll(polled, max_in_flight, at),
            self._driver.loop_time,
            self._driver.wait_until,
            lambda: self.closed,
        )

    async def _follow(self, make: Any, arguments: Any, named: Any) -> Any:
        """Carry out a procedure."""
        steps = make(self, *arguments, **named)
        try:
            step = next(steps)
            while True:
                step = steps.send(await self._take(step))
        except StopIteration as done:
            return done.value
        except InvalidResponse as error:
            raise self._named(error) from None

    async def _take(self, step: pdu.Request[Any] | Several | ChangeRegister) -> Any:
        if isinstance(step, ChangeRegister):
            async with self._driver.changing:
                (register,) = await self.execute(pdu.ReadHoldingRegisters(step.request.address, 1))
                return await self.execute(step.write(register))
        if not isinstance(step, Several):
            return await self.execute(step)
        batch = self._batch(step.requests, step.max_in_flight, step.return_exceptions)
        if batch.pdus:
            await self._driver.run(batch)
        raised(batch.outcomes, step.returned)
        return batch.outcomes


class Submitted:
    """A request that was submitted."""

    __slots__ = ("_batch", "_driver")

    def __init__(self, batch: Batch, driver: AsyncioDriver) -> None:
        self._batch = batch
        self._driver = driver

    @property
    def outcome(self) -> Any:
        """Its result, or the exception that `AsyncClient.execute` would raise, once it is known."""
        return self._batch.outcomes[0]

    def withdraw(self) -> None:
        """Drop the request: `on_done` is not called, and a later answer is dropped."""
        self._driver.withdraw(self._batch)


class _Life:
    """Lives as long as any handle; warns about a connection left open, and closes it."""

    def __init__(self, driver: AsyncioDriver) -> None:
        self._driver = driver

    def __del__(self) -> None:
        self._driver.forget()
