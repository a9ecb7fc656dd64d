"""
A handle to one unit on a connection, blocking or not.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, Self, Unpack

from ..ports.port import make_port
from ..protocol.checks import integer, seconds
from .call import Batch, Timeouts
from .keywords import NoOthers, public_methods, unexpected
from .options import Options, checked_options, line_options
from .reconnecting import State

if TYPE_CHECKING:
    from ..maps.plan import Plan
    from ..maps.refusals import Refusals, UnreadableItem
    from ..maps.register_map import AnyMap
    from ..ports.port import Port
    from ..protocol import pdu
    from ..protocol.tables import WriteFunction
    from .connection import Transactions
    from .statistics import Statistics

__all__ = ["Handle"]


@public_methods("Handle")
class Handle:
    """The base of both clients: a unit, its timeouts, and the connection that handles share."""

    _driver: Any

    def __init__(
        self,
        url: str,
        options: Mapping[str, Any],
        kind: type[Options],
        make_driver: Callable[[Port, Transactions], object],
        **usual: Any,
    ) -> None:
        """Make a client with options of a kind, of which some have other defaults than usual."""
        # Imported here, because the parts of a client take longer to import than this module, and
        # some programs make no client. A first read may find no descriptor to import `reads` with.
        from ..ports.endpoint import parse
        from ..protocol.pdu import reads  # noqa: F401
        from .connection import Transactions

        endpoint, others = line_options(parse(url), options)
        settings = checked_options(endpoint, others, kind, **usual)
        port = make_port(endpoint, settings)
        self._unit = settings["unit"]
        self._timeouts = Timeouts(
            float(settings["timeout"]), settings["retries"], settings["busy_retries"]
        )
        self._write_function: WriteFunction = settings["write_function"]
        self._endpoint = endpoint
        self._connection = Transactions(endpoint, settings, port)
        self._has_broadcast = not endpoint.has_transactions and settings["broadcast"]
        self._driver = make_driver(port, self._connection)
        self._refusals_of: dict[int, Refusals] = {}

    def for_unit(
        self,
        unit: int,
        *,
        timeout: float | None = None,
        retries: int | None = None,
        write_function: WriteFunction | None = None,
        **wrong: Unpack[NoOthers],
    ) -> Self:
        """
        Return a handle to another unit on the same connection.

        Closing either handle closes the connection of both.

        Args:
            unit: 0..255; 0 is a broadcast on serial lines: only writes can be sent, and they
                return after the turnaround.
            timeout: seconds, 0.001..86400; None to share this handle's.
            retries: 0..100; None to share this handle's.
            write_function: "auto", "single" or "multiple" (`Options`); None to share this handle's.

        Raises:
            TypeError, ValueError: an argument of the wrong type or range.
        """
        if wrong:
            raise unexpected(self.for_unit, wrong)
        handle = copy.copy(self)
        handle.unit = unit
        handle._timeouts = self._timeouts.but(timeout, retries)
        if write_function is not None:
            from ..protocol.tables import checked_write_function

            handle._write_function = checked_write_function(write_function)
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

    def unreadable(self, what: AnyMap | Plan, **wrong: Unpack[NoOthers]) -> list[UnreadableItem]:
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
        if wrong:
            raise unexpected(self.unreadable, wrong)
        from ..maps.plan import Plan, unreadable_of
        from ..maps.register_map import RegisterMap, map_of

        if isinstance(what, RegisterMap | str | PathLike):
            what = map_of(what).plan()
        if not isinstance(what, Plan):
            raise TypeError(f"what must be a RegisterMap or a Plan, not {type(what).__name__}")
        return unreadable_of(what, self._refusals, self._device)

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {self._endpoint}, unit {self.unit}, {self.state.value}>"

    # --- for the methods ----------------------------------------------------------------

    @property
    def _device(self) -> str:
        """The device behind this handle, for messages."""
        return f"{self.url}, unit {self.unit}"

    @property
    def _refusals(self) -> Refusals:
        """The refusals of the unit, shared by all handles of this client."""
        from ..maps.refusals import Refusals

        return self._refusals_of.setdefault(self._unit, Refusals())

    def _batch(
        self,
        requests: Iterable[pdu.Request[Any]],
        return_exceptions: bool,
        *,
        is_poll: bool = False,
    ) -> Batch:
        """Check and encode all requests before the first is sent."""
        if not isinstance(requests, Iterable):
            raise TypeError(f"requests must be a list, not {type(requests).__name__}")
        return Batch(
            self.unit,
            list(requests),
            self._timeouts,
            name="requests[{}]",
            is_broadcast=self._unit == 0 and self._has_broadcast,
            one_by_one=self.max_in_flight == 1,
            go_on=bool(return_exceptions),
            is_poll=is_poll,
        )

    def _log_refusal(self, which: str) -> None:
        """Log the cells that the unit refuses."""
        from ..protocol.logs import HarmlessLogger

        HarmlessLogger(__name__).info("%s: cannot be read: %s", self._device, which)
