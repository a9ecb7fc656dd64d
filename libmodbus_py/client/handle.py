"""
A handle to one unit on a connection, blocking or not.
"""

from __future__ import annotations

import copy
from collections.abc import Hashable, Iterable
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import InvalidResponse
from .batch import MAX_IN_FLIGHT, Batch
from .reconnecting import State

if TYPE_CHECKING:
    from .options import CheckedOptions, Parts
    from .statistics import Statistics
    from .timeouts import Timeouts

__all__ = ["Handle"]


class Driver(Protocol):
    """The part of a driver that handles use."""

    def change_timeout(self) -> None: ...

    def now(self) -> float: ...


Driving = TypeVar("Driving", bound=Driver)


class Handle(Generic[Driving]):
    """
    The base of both clients: a unit, its timeouts, and the connection that it shares.
    """

    def __init__(
        self,
        parts: Parts,
        settings: CheckedOptions,
        driver: Driving,
        timeouts: Timeouts | None = None,
    ) -> None:
        self._unit = settings.unit
        self._timeouts = timeouts or settings.timeouts
        self._endpoint = parts.endpoint
        self._connection = parts.connection
        self._conversation = parts.conversation
        self._statistics = parts.statistics
        self._has_broadcast = parts.endpoint.framing in ("rtu", "ascii")
        self._driver = driver

    def for_unit(
        self, unit: int, *, timeout: float | None = None, retries: int | None = None
    ) -> Self:
        """
        Return a handle to another unit, 0..255, on the same connection.

        Unit 0 is a broadcast on serial lines: writes only, which return after
        the turnaround. Closing either handle closes the connection of both.

        Args:
            timeout: seconds, 0.001..86400; None to share this handle's.
            retries: 0..100; None to share this handle's.
        """
        handle = copy.copy(self)
        handle.unit = unit
        handle._timeouts = self._timeouts.but(timeout, retries)
        return handle

    @property
    def unit(self) -> int:
        """
        The unit that is asked, 0..255; settable.

        Raises:
            TypeError, ValueError: when set to something else.
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
        """Seconds that one request may take, connecting included; settable."""
        return self._timeouts.timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._timeouts.timeout = seconds("timeout", value)
        self._driver.change_timeout()

    @property
    def state(self) -> State:
        """The state of the connection."""
        return self._connection.state

    @property
    def closed(self) -> bool:
        """True once `close` was called."""
        return self.state is State.CLOSED

    @property
    def statistics(self) -> Statistics:
        """The statistics of the connection; live."""
        return self._statistics

    @property
    def max_in_flight(self) -> int:
        """The most requests that wait for their answers together: as set, or as found out."""
        return self._conversation.limit

    @property
    def late_answers(self) -> int:
        """Number of answers that were dropped, because their request had been given up."""
        return self._statistics.late_answers

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {self._endpoint}, unit {self.unit}, {self.state.value}>"

    # --- implemented by each client; documented here ------------------------------------------

    def execute(self, *args: Any, **kwargs: Any) -> Any:
        """
        Send any request object of `libmodbus_py.pdu`.

        Args:
            timeout, retries: of this request; None for those of the handle.

        Returns:
            What the method of the same name returns.
        """
        raise NotImplementedError

    def read_many(self, *args: Any, **kwargs: Any) -> Any:
        """
        Read many things in few requests.

        Args:
            items: a `Plan`; or what makes one, such as
                ``{"level": ("holding_registers", 100, 1, "float32"), "valves": ("coils", 0, 8)}``.
            max_in_flight, return_exceptions: as for `execute_many`; a ModbusError stands in
                the place of what was to come with a failed request.
            options: of the plan, where `items` is none: `gap`, `forbidden`,
                `max_registers`, `max_bits`.

        Returns:
            A list of values for each item, in their order; a dict where `items`
            was a mapping.

        Raises:
            TypeError, ValueError: as of `Plan`; registers that hold no such value.
            IllegalDataAddress: a merged request covers cells that the device
                lacks. With a `Plan`, what is refused is found by halving the request: it is
                left out with `return_exceptions` (`Plan.unreadable`), else it is named in
                `names` of the error.
        """
        raise NotImplementedError

    def watch(self, *args: Any, **kwargs: Any) -> Any:
        """
        Read the same again and again, at a steady pace.

        ``for values in plc.watch(meter, every=1)``; with `AsyncClient` ``async for``.

        The first values are read at once, those after them after one interval, two and so on, from
        start to start. Where the device or the program takes longer, the polls that are late are
        left out.

        A device that does not answer ends nothing: the reasons stand in place of the values,
        and the client connects again by itself. The loop ends when the client is closed, also from
        another thread or task, and may be left in any way.

        Args:
            what: a `RegisterMap`, a `Plan`, or what makes one, as for `read_many`.
            every: seconds from one poll to the next, 0.01..86400; of points with an interval of
                their own (`Point.interval`), that from one read to the next. Polls then come at the
                shortest interval, and points that are not due keep their values.
            names: of the points of the map; None for all that can be read.
            max_in_flight: as for `execute_many`.
            options: of the plan: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Returns:
            An iterator. Of a map it yields what `read_map` returns with ``return_exceptions=True``,
            in a dict whose `fell` has the names of totals (`Point.never_falls`) that were read
            twice because they are smaller than before; else what `read_many` returns so.

        Raises:
            TypeError, ValueError: an argument, before anything is sent. The iterator itself raises
                ValueError for registers that hold no value of their type, if `what` is no map.
        """
        raise NotImplementedError

    # --- for procedures ----------------------------------------------------------------

    @property
    def device(self) -> tuple[Hashable, int]:
        """The device behind this handle: equal for all handles to the same unit of an endpoint."""
        return self._endpoint.place, self._unit

    @property
    def connection(self) -> tuple[int, int]:
        """The client, and how many connections it has made; another one after each connection."""
        return id(self._connection), self._statistics.connects

    def now(self) -> float:
        """Return the time in seconds, of the clock by which timeouts are measured."""
        return self._driver.now()

    # --- for the clients ----------------------------------------------------------------

    @property
    def _is_broadcast(self) -> bool:
        return self.unit == 0 and self._has_broadcast

    def _batch(
        self, requests: Iterable[pdu.Request[Any]], max_in_flight: int, go_on: bool
    ) -> Batch:
        """Check and encode all before the first is sent."""
        limit = integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        if not isinstance(requests, Iterable):
            raise TypeError(f"requests must be a list, not {type(requests).__name__}")
        return Batch(
            self.unit,
            list(requests),
            self._timeouts,
            name="requests[{}]",
            is_broadcast=self._is_broadcast,
            limit=limit,
            go_on=bool(go_on),
        )

    def _named(self, error: InvalidResponse) -> InvalidResponse:
        """Return an error of a procedure with its unit and endpoint."""
        error.unit, error.endpoint = self.unit, self.url
        return error
