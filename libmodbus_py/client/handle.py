"""
A handle to one unit on a connection, blocking or not.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Generator, Iterable, Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, Generic, Self, Unpack, overload

from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import InvalidResponse, ModbusError
from .call import MAX_IN_FLIGHT, Batch, Call, raised
from .polling import Driving, Polls, watched
from .reconnecting import State
from .requests import LOCK, Several, Step, Steps

if TYPE_CHECKING:
    from ..maps.holes import Holes, Unreadable
    from ..maps.plan import Item, Items, Key, Named, Plan, PlanOptions, Strict, Tolerant, Values
    from ..maps.register_map import AnyMap
    from ..maps.watched import PolledValues
    from ..ports.endpoint import Endpoint
    from ..ports.port import Port
    from .asyncio_driver import AsyncioDriver
    from .blocking_driver import BlockingDriver
    from .connection import Transactions
    from .options import CheckedOptions
    from .requests import Later
    from .statistics import Statistics

__all__ = ["Handle"]


class Handle(Generic[Driving]):
    """The base of both clients: a unit, its timeouts, and the connection that handles share."""

    if TYPE_CHECKING:
        _poll: Any  # of `Procedures`
        _read_many: Any

    def __init__(
        self,
        endpoint: Endpoint,
        options: Mapping[str, Any],
        make_driver: Callable[[Endpoint, CheckedOptions, Port, Transactions], Driving],
        **usual: Any,
    ) -> None:
        """
        Make a client. These are the options of all clients, with their defaults; times are in
        seconds, and `client.options.Options` describes each in full:

            unit=1                      the unit to which requests are sent, 0..255
            timeout=1.0                 the longest time that a request may take
            retries=0                   how often a request is sent again without a good response
            busy_retries=0              the same for a device that reports that it is busy
            max_in_flight=1             the most reads that may be pending at the same time
            turnaround=0.1              the duration of a broadcast
            request_spacing=0.0         the minimum time between the starts of two requests
            connect_delay=0.0           the time between connecting and the first request
            timeouts_before_reconnect=3 timeouts in a row after which the next request reconnects
            max_pause=0.0               the longest pause between two attempts to connect
            keepalive=30.0              the silence after which TCP probes the peer; None for never
            accept_unit="same"          "any" accepts responses from other units
            delimiter=10                the byte after CR in ASCII frames
            security=None               the certificates for TLS, a `Security`
            trace=None                  called with each ADU, as a `Traced`
            on_state=None               called with each new `State`, and the error that led to it
            statistics=None             the `Statistics` to count in; None for new ones

        `AsyncClient` also has, and differs in one default:

            may_send=None               requests are sent only while this function returns True
            max_pause=30.0              the longest pause between two attempts to connect
        """
        # Imported here, because the parts of a client take longer to import than this module, and
        # some programs make no client. A first read may find no descriptor to import `reads` with.
        from ..ports.port import make_port
        from ..protocol.pdu import reads  # noqa: F401
        from .connection import Transactions
        from .options import CheckedOptions

        settings = CheckedOptions.of(endpoint, options, **usual)
        port = make_port(endpoint, settings)
        self._unit = settings.unit
        self._timeouts = settings.timeouts
        self._endpoint = endpoint
        self._connection = Transactions(endpoint, settings, port)
        self._has_broadcast = endpoint.framing in ("rtu", "ascii")
        self._driver = make_driver(endpoint, settings, port, self._connection)
        self._holes: dict[int, Holes] = {}

    def for_unit(
        self, unit: int, *, timeout: float | None = None, retries: int | None = None
    ) -> Self:
        """
        Return a handle to another unit on the same connection.

        Closing either handle closes the connection of both.

        Args:
            unit: 0..255; 0 is a broadcast on serial lines: only writes can be sent, and they
                return after the turnaround.
            timeout: seconds, 0.001..86400; None to share this handle's.
            retries: 0..100; None to share this handle's.

        Raises:
            TypeError, ValueError: an argument of the wrong type or range.
        """
        handle = copy.copy(self)
        handle.unit = unit
        handle._timeouts = self._timeouts.but(timeout, retries)
        return handle

    @property
    def unit(self) -> int:
        """
        The unit to which requests are sent, 0..255; settable.

        Raises:
            TypeError, ValueError: it is set to anything else.
        """
        return self._unit

    @unit.setter
    def unit(self, value: int) -> None:
        self._unit = integer("unit", value, 0, 255)

    @property
    def url(self) -> str:
        """The URL of the connection."""
        return str(self._endpoint)

    @property
    def timeout(self) -> float:
        """
        The seconds that one request may take, connecting included, 0.001..86400; settable.

        Raises:
            TypeError, ValueError: it is set to anything else.
        """
        return self._timeouts.timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._timeouts.timeout = seconds("timeout", value)
        self._driver.change_timeout()

    @property
    def state(self) -> State:
        """The state of the connection."""
        return self._connection.life.state

    @property
    def closed(self) -> bool:
        """True once `close` was called."""
        return self.state is State.CLOSED

    @property
    def statistics(self) -> Statistics:
        """The statistics of the connection, which it keeps up to date."""
        return self._connection.statistics

    @property
    def max_in_flight(self) -> int:
        """The most reads that may be pending at the same time, as set."""
        return self._connection.limit

    @property
    def late_answers(self) -> int:
        """The number of responses that were dropped because their request had been given up."""
        return self.statistics.late_answers

    def unreadable(self, what: AnyMap | Plan) -> list[Unreadable]:
        """
        Return the items that this client leaves out, because the unit refused them.

        `read_map`, `read_many` of a `Plan`, and `watch` find them, and try them again, one in each
        call, after ten minutes and after a new connection. All handles to a unit that `for_unit`
        made of one client share what they know.

        Args:
            what: a `RegisterMap` or the path of its file, of which all readable points count; or a
                `Plan`.

        Raises:
            TypeError: `what` is none of them.
            MapError: as for `load_map`.
        """
        from ..maps.plan import Plan, unreadable_of
        from ..maps.register_map import RegisterMap, map_of

        if isinstance(what, RegisterMap | str | PathLike):
            what = map_of(what).plan()
        if not isinstance(what, Plan):
            raise TypeError(f"what must be a RegisterMap or a Plan, not {type(what).__name__}")
        return unreadable_of(what, self.holes, self.device)

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {self._endpoint}, unit {self.unit}, {self.state.value}>"

    # --- implemented by each client; documented here ------------------------------------------

    def execute(self, *args: Any, **kwargs: Any) -> Any:
        """
        Send any request object of `libmodbus_py.pdu`, and return its result.

        Args:
            request: the request object.
            timeout: seconds for this request, 0.001..86400; None for the handle's.
            retries: retries of this request, 0..100; None for the handle's.

        Returns:
            The result that the client's method for the same function returns.
        """
        raise NotImplementedError

    @overload
    def read_many(  # type: ignore[overload-overlap]
        self: Handle[BlockingDriver], items: Named[Key], **options: Unpack[Strict]
    ) -> dict[Key, Values]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self: Handle[BlockingDriver], items: Named[Key], **options: Unpack[Tolerant]
    ) -> dict[Key, Values | ModbusError]: ...
    @overload
    def read_many(
        self: Handle[BlockingDriver], items: Iterable[Item], **options: Unpack[Strict]
    ) -> list[Values]: ...
    @overload
    def read_many(
        self: Handle[BlockingDriver], items: Iterable[Item], **options: Unpack[Tolerant]
    ) -> list[Values | ModbusError]: ...
    @overload
    def read_many(
        self: Handle[BlockingDriver],
        items: Plan,
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> Any: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self: Handle[AsyncioDriver], items: Named[Key], **options: Unpack[Strict]
    ) -> Later[dict[Key, Values]]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self: Handle[AsyncioDriver], items: Named[Key], **options: Unpack[Tolerant]
    ) -> Later[dict[Key, Values | ModbusError]]: ...
    @overload
    def read_many(
        self: Handle[AsyncioDriver], items: Iterable[Item], **options: Unpack[Strict]
    ) -> Later[list[Values]]: ...
    @overload
    def read_many(
        self: Handle[AsyncioDriver], items: Iterable[Item], **options: Unpack[Tolerant]
    ) -> Later[list[Values | ModbusError]]: ...
    @overload
    def read_many(
        self: Handle[AsyncioDriver],
        items: Plan,
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> Later[Any]: ...
    def read_many(
        self,
        items: Plan | Items,
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> Any:
        """
        Read many items with few requests.

        Args:
            items: a `Plan`, or the items of one, such as
                ``{"level": ("holding_registers", 100, 1, "float32"), "valves": ("coils", 0, 8)}``.
            max_in_flight, return_exceptions: as for `execute_many`; each item of a failed
                request gets a ModbusError in place of its values.
            options: the options of `Plan`, unless `items` is one: `gap`, `forbidden`,
                `max_registers`, `max_bits`.

        Returns:
            A list of values for each item, in the order of the items; a dict by name if `items`
            is a mapping.

        Raises:
            TypeError, ValueError: an argument is wrong, as for `Plan`; or registers hold no value
                of the type of an item.
            IllegalDataAddress: a merged request covers cells that the device
                lacks. With a `Plan`, the items that the device refuses are found by halving the
                request; with `return_exceptions` they are left out (`unreadable`), otherwise
                the first of them is named in `names` of the error.
        """
        return self._read_many(items, max_in_flight, return_exceptions, options)

    @overload
    def watch(
        self,
        what: AnyMap,
        *,
        every: float,
        names: Iterable[str] | None = None,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[Driving, PolledValues]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self,
        what: Named[Key],
        *,
        every: float,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[Driving, dict[Key, Values | ModbusError]]: ...
    @overload
    def watch(
        self,
        what: Iterable[Item],
        *,
        every: float,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[Driving, list[Values | ModbusError]]: ...
    @overload
    def watch(
        self, what: Plan, *, every: float, max_in_flight: int = 16
    ) -> Polls[Driving, Any]: ...
    def watch(
        self,
        what: AnyMap | Plan | Items,
        *,
        every: float,
        names: Iterable[str] | None = None,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[Driving, Any]:
        """
        Read the same points or items again and again, at a steady pace.

        ``for values in plc.watch(meter, every=1)``; ``async for`` with an `AsyncClient`.

        The first values are read at once; later polls start at whole multiples of the interval
        after the first one. If the device or the program takes longer than that, the polls that it
        misses are skipped.

        If the device does not answer, the loop goes on: it yields errors in place of values,
        and the client connects again by itself. The loop ends when the client is closed, even by
        another thread or task, and may be left at any time.

        Args:
            what: a `RegisterMap` or the path of its file, a `Plan`, or the items of one, as for
                `read_many`.
            every: seconds from one poll to the next, 0.01..86400. A point with an interval of its
                own (`Point.interval`) is read at that interval instead: polls then come at the
                shortest interval, and points that are not due keep their values.
            names: the names of the points of the map to read; None for all readable points.
            max_in_flight: as for `execute_many`.
            options: the options of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Returns:
            An iterator. For a map, it yields what `read_map` returns with
            ``return_exceptions=True``, in a dict whose attribute `fell` has the names of totals
            (`Point.never_falls`) that are smaller than before, even when they were read a second
            time. Otherwise it yields what `read_many` returns with ``return_exceptions=True``.

        Raises:
            TypeError, ValueError: an argument is wrong; nothing was sent. If `what` is no map, the
                iterator itself raises ValueError for registers that hold no value of their type.
        """
        interval = seconds("every", every, 0.01)
        polled = watched(what, names, interval, options)
        integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        return Polls(
            self,
            getattr(polled, "interval", interval),
            lambda at: self._poll(polled, max_in_flight, at),
        )

    # --- for procedures ----------------------------------------------------------------

    @property
    def device(self) -> str:
        """The device behind this handle, for messages."""
        return f"{self.url}, unit {self.unit}"

    @property
    def holes(self) -> Holes:
        """The refusals of the unit, as all handles of this client know them."""
        from ..maps.holes import Holes

        return self._holes.setdefault(self._unit, Holes())

    def now(self) -> float:
        """Return the time in seconds, of the clock by which timeouts are measured."""
        return self._driver.now()

    # --- for the clients ----------------------------------------------------------------

    def _call(
        self, unit: int, request: pdu.Request[Any], timeout: float | None, retries: int | None
    ) -> Call:
        """Check and encode a request."""
        timeouts = self._timeouts
        if timeout is not None or retries is not None:
            timeouts = timeouts.but(timeout, retries)
        return Call(unit, request, timeouts, unit == 0 and self._has_broadcast)

    def _batch(self, several: Several) -> Batch:
        """Check and encode all before the first is sent."""
        limit = integer("max_in_flight", several.max_in_flight, 1, MAX_IN_FLIGHT)
        requests = several.requests
        if not isinstance(requests, Iterable):
            raise TypeError(f"requests must be a list, not {type(requests).__name__}")
        return Batch(
            self.unit,
            list(requests),
            self._timeouts,
            name="requests[{}]",
            is_broadcast=self._unit == 0 and self._has_broadcast,
            limit=min(limit, self.max_in_flight),
            go_on=bool(several.return_exceptions),
        )

    def _jobs(self, steps: Steps[Any]) -> Generator[Call | Batch | None, None, Any]:
        """Follow a procedure: yield what is to be run; None to hold the lock from then on."""
        job: Call | Batch
        outcome: Any = None
        try:
            while True:
                step = steps.send(outcome)
                if step is LOCK:
                    yield None
                    continue
                if isinstance(step, Several):
                    job = self._batch(step)
                    yield job
                    outcome = job.outcomes
                    is_tolerant = step.return_exceptions or step.stops
                    raised(outcome, (ModbusError,) if is_tolerant else ())
                    continue
                if isinstance(step, Step):  # CONNECT
                    job = Call(self._unit, None, self._timeouts)
                else:
                    job = self._call(self._unit, step, None, None)
                yield job
                outcome = job.outcome
                raised([outcome])
        except StopIteration as done:
            return done.value
        except InvalidResponse as error:
            error.unit, error.endpoint = self.unit, self.url
            raise error from None
