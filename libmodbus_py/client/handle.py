"""
A handle to one unit on a connection, blocking or not; and the errors for keyword arguments that its
methods do not have.

A method ends with ``**wrong: Unpack[NoOthers]``, which costs a call less than a decorator that
catches errors. Type checkers refuse every such argument, and `public_methods` hides it from help()
and from mocks.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterable, Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, Self, TypedDict, TypeVar, Unpack

from ..protocol.checks import integer, seconds
from ..protocol.mistakes import OTHER_SPELLINGS, close_option, close_to
from .call import Batch
from .reconnecting import State

if TYPE_CHECKING:
    from ..maps.holes import Holes, Unreadable
    from ..maps.plan import Plan
    from ..maps.register_map import AnyMap
    from ..ports.endpoint import Endpoint
    from ..ports.port import Port
    from ..protocol import pdu
    from ..protocol.tables import WriteFunction
    from .connection import Transactions
    from .options import CheckedOptions
    from .statistics import Statistics

__all__ = ["Handle", "Missing", "NoOthers", "check_plan_options", "public_methods", "unexpected"]

Class = TypeVar("Class", bound=type)

# Of code: it has **keywords. The module inspect, which names it, takes long to import.
CO_VARKEYWORDS = 0x08


class NoOthers(TypedDict):
    """The keyword arguments that a method takes besides those of its signature: none."""


def unexpected(method: Any, given: Iterable[str], known: Collection[str] = ()) -> TypeError:
    """
    Return the error for keyword arguments that a method does not take.

    Args:
        method: the method of a client.
        given: the names of arguments; the first one that is not `known` is wrong.
        known: names that the method takes besides those of its signature.
    """
    from .options import Options

    name = next(each for each in given if each not in known)
    code = method.__func__.__code__
    own = [*code.co_varnames[1 : code.co_argcount + code.co_kwonlyargcount], *known]
    options = Options.__annotations__
    meant = OTHER_SPELLINGS.get(name.lower(), name)
    if meant not in own and meant in options:
        close = "; " if meant == name else f"; did you mean {meant}? "
        close += "it is an argument of the client"
    elif not (close := close_option(name, own)) and (close := close_to(name, options)):
        close += " it is an argument of the client"
    called = f"{type(method.__self__).__name__}.{method.__name__}()"
    return TypeError(f"{called} got an unexpected keyword argument {name!r}{close}")


def check_plan_options(method: Any, options: Mapping[str, Any]) -> None:
    """Raise the error for the first option that is none of a `Plan`."""
    from ..maps.plan import PlanOptions

    known = PlanOptions.__annotations__
    if not options.keys() <= known.keys():
        raise unexpected(method, options, known)


def public_methods(owner: str | None = None) -> Callable[[Class], Class]:
    """
    Decorate a class whose methods end with ``**wrong``; the class is called `owner` in errors.

    An argument without a default gets one, `Missing`, so that a misspelt argument is not reported
    as the lack of another one; the checks of arguments refuse it. help(), inspect.signature() and
    mocks with a specification see the signatures as they are written, without ``**wrong``: they
    follow `__wrapped__`, which is never called.
    """

    def decorated(cls: Class) -> Class:
        for function in vars(cls).values():
            code = getattr(function, "__code__", None)
            if code is None or code.co_name.startswith("__"):
                continue
            if owner:
                function.__qualname__ = f"{owner}.{function.__name__}"
            if code.co_flags & CO_VARKEYWORDS:
                function.__wrapped__ = _signed(function)
                _add_defaults(function)
        return cls

    return decorated


def _signed(function: Any) -> Any:
    """Return a function with the signature of another one, without ``**wrong``."""
    code, annotations = function.__code__, {**function.__annotations__}
    if annotations.pop("wrong", None):
        code = code.replace(co_flags=code.co_flags & ~CO_VARKEYWORDS)
    signed = type(function)(code, {}, function.__name__, function.__defaults__)
    signed.__kwdefaults__, signed.__annotations__ = function.__kwdefaults__, annotations
    return signed


def _add_defaults(function: Any) -> None:
    code, missing = function.__code__, Missing()
    defaults = function.__defaults__ or ()
    function.__defaults__ = (missing,) * (code.co_argcount - 1 - len(defaults)) + defaults
    named = code.co_varnames[code.co_argcount : code.co_argcount + code.co_kwonlyargcount]
    function.__kwdefaults__ = {**dict.fromkeys(named, missing), **(function.__kwdefaults__ or {})}


class Missing:
    """The value of an argument that was not given."""


@public_methods()
class Handle:
    """The base of both clients: a unit, its timeouts, and the connection that handles share."""

    _driver: Any

    def __init__(
        self,
        endpoint: Endpoint,
        options: Mapping[str, Any],
        make_driver: Callable[[Endpoint, CheckedOptions, Port, Transactions], object],
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
            write_function="auto"       "single" writes values with functions 5 and 6, "multiple"
                                        with 15 and 16
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
        self._write_function: WriteFunction = settings.write_function
        self._endpoint = endpoint
        self._connection = Transactions(endpoint, settings, port)
        self._has_broadcast = endpoint.framing in ("rtu", "ascii")
        self._driver = make_driver(endpoint, settings, port, self._connection)
        self._holes: dict[int, Holes] = {}

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

    @property
    def late_answers(self) -> int:
        """The number of responses that were dropped because their request had been given up."""
        return self.statistics.late_answers

    def unreadable(self, what: AnyMap | Plan, **wrong: Unpack[NoOthers]) -> list[Unreadable]:
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
        return unreadable_of(what, self.holes, self.device)

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {self._endpoint}, unit {self.unit}, {self.state.value}>"

    # --- for the methods ----------------------------------------------------------------

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
        time: float = self._driver.now()
        return time

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
            limit=self.max_in_flight,
            go_on=bool(return_exceptions),
            is_poll=is_poll,
        )

    def _tell_of_hole(self, which: str) -> None:
        """Log what the unit refuses."""
        from ..protocol.logs import HarmlessLogger

        HarmlessLogger(__name__).info("%s: cannot be read: %s", self.device, which)
