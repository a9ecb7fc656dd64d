"""
The options of clients, checked once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from ..ports.endpoint import Endpoint
from ..ports.schemes import SERIAL_OPTIONS
from ..ports.trace import OnTraced
from ..protocol.checks import checked_callback, integer, seconds
from ..protocol.framing import is_delimiter
from ..protocol.mistakes import unknown_option
from .call import MAX_IN_FLIGHT, Timeouts
from .reconnecting import OnState
from .statistics import Statistics

if TYPE_CHECKING:  # ssl, which it needs, takes longer to import than the rest of a client
    from ..protocol.tables import WriteFunction
    from ..security.security import GivenContext, Security

__all__ = ["AsyncOptions", "CheckedOptions", "Options"]


OF_ASYNC_CLIENTS = ("may_send",)
"""Options that only `AsyncClient` has."""


class Options(TypedDict, total=False):
    """
    The options that all clients have; times are in seconds.

    Keys:
        unit: the unit to which requests are sent, 0..255; 1 by default. 0 is a broadcast on
            serial lines: only writes can be sent, and they return after the turnaround.
        timeout: the longest time that one request may take, 0.001..86400, from the call to the
            end of its response, including the time to connect, but not the time it waits for
            other requests. 1 by default.
        retries: how often a request is sent again if there was no response or a damaged one, or
            if the connection was lost, 0..100; only requests that may be sent twice
            (``pdu.Request.repeatable``). 0 by default.
        busy_retries: how often a request is sent again that was refused with Acknowledge
            or ServerDeviceBusy, 0..100, after 0.1, 0.2, 0.4, 0.8, 1, 1... s. 0 by default.
        max_in_flight: the most reads that may be pending at the same time, 1..256; only 1 where
            frames carry no transaction id. A write is always alone. 1 by default: many devices
            lose requests that arrive together; servers need not accept more than 16 (TCP guide,
            4.3.3).
        turnaround: the duration of a request that gets no response (serial line, 2.4.1). 0.1 by
            default.
        request_spacing: the minimum time between the starts of two requests, for devices that
            need a pause; it does not count towards `timeout`. 0 by default.
        connect_delay: the time between connecting and the first request, for devices that need
            to get ready; it does not count towards `timeout`. 0 by default.
        timeouts_before_reconnect: the number of timeouts in a row, cancelled requests included,
            after which a network connection is considered dead, 1..1000000: the next request
            opens a new one. 3 by default.
        max_pause: the longest pause before the next attempt to connect; pauses begin at 0.1 s
            and double. 0 means no pauses. 0 by default for `Client`, 30 for `AsyncClient`.
        keepalive: the duration of silence after which TCP probes whether the peer is still
            there, 1..32767; None for never. 30 by default.
        accept_unit: "any" accepts responses from a unit other than the one addressed, because
            some TCP devices answer every request as unit 255; "same" by default.
        write_function: how `write_map` and `write_value` write, for devices that lack a function:
            "single" with functions 5 and 6, each coil and register with a request of its own, so
            that the device sees a value of two registers in two halves; "multiple" with 15 and 16;
            "auto" by default: single coils and registers of maps with 5 and 6, several with 15
            and 16.
        delimiter: the byte after CR in ASCII frames; 10 by default, which is LF. The client uses
            a new delimiter once it has set it with `diagnostics(3, ...)`.
        security: the client's own certificate and those it trusts, for "tls" only; the URL may
            name them instead. `GivenContext` is for programs that must use an SSL context of
            their own.
        trace: called with a `Traced` for every ADU sent and received; the logger
            ``libmodbus_py.wire`` gets the same at DEBUG.
        on_state: called with each new `State`, and with the ModbusError that led to it or
            None. It must not block.
        statistics: the `Statistics` in which to count, for programs that make several clients
            for the same endpoint, one after the other; a new one by default.
    """

    unit: int
    timeout: float
    retries: int
    busy_retries: int
    max_in_flight: int
    turnaround: float
    request_spacing: float
    connect_delay: float
    timeouts_before_reconnect: int
    max_pause: float
    keepalive: float | None
    accept_unit: Literal["same", "any"]
    write_function: WriteFunction
    delimiter: int
    security: Security | GivenContext | None
    trace: OnTraced | None
    on_state: OnState | None
    statistics: Statistics | None


class AsyncOptions(Options, total=False):
    """
    The options of `AsyncClient`.

    Keys:
        may_send: called right before bytes are sent, and before connecting. While it returns
            False, requests are not sent and raise ModbusConnectionError (EPERM). For several
            programs of which only one at a time may send requests. It must not block.
    """

    may_send: Callable[[], bool] | None


@dataclass(frozen=True, slots=True)
class CheckedOptions:
    """`AsyncOptions`, checked."""

    unit: int = 1
    timeout: float = 1.0
    retries: int = 0
    busy_retries: int = 0
    max_in_flight: int = 1
    turnaround: float = 0.1
    request_spacing: float = 0.0
    connect_delay: float = 0.0
    timeouts_before_reconnect: int = 3
    max_pause: float = 0.0
    keepalive: float | None = 30.0
    accept_unit: str = "same"
    write_function: WriteFunction = "auto"
    delimiter: int = 0x0A
    security: Security | GivenContext | None = None
    trace: OnTraced | None = None
    on_state: OnState | None = None
    statistics: Statistics | None = None
    may_send: Callable[[], bool] | None = None

    def __post_init__(self) -> None:
        integer("unit", self.unit, 0, 255)
        seconds("timeout", self.timeout)
        integer("retries", self.retries, 0, 100)
        integer("busy_retries", self.busy_retries, 0, 100)
        integer("timeouts_before_reconnect", self.timeouts_before_reconnect, 1, 1_000_000)
        for name in ("turnaround", "request_spacing", "connect_delay", "max_pause"):
            seconds(name, getattr(self, name), low=0)
        integer("max_in_flight", self.max_in_flight, 1, MAX_IN_FLIGHT)
        if self.keepalive is not None:
            seconds("keepalive", self.keepalive, 1, 32_767)
        if self.accept_unit not in ("same", "any"):
            raise ValueError(f'accept_unit must be "same" or "any", not {self.accept_unit!r}')
        if self.write_function not in ("auto", "single", "multiple"):
            words = '"auto", "single" or "multiple"'
            raise ValueError(f"write_function must be {words}, not {self.write_function!r}")
        if not is_delimiter(integer("delimiter", self.delimiter, 0, 0xFF)):
            raise ValueError(
                f"delimiter must be an ASCII code with no other use, not {self.delimiter}"
            )
        if self.security is not None:
            from ..security.security import GivenContext, Security

            if not isinstance(self.security, Security | GivenContext):
                given = type(self.security).__name__
                raise TypeError(f"security must be Security, not {given}")
        for name in ("trace", "on_state", "may_send"):
            if (hook := getattr(self, name)) is not None:
                checked_callback(name, hook)
        if self.statistics is not None and not isinstance(self.statistics, Statistics):
            raise TypeError(f"statistics must be Statistics, not {type(self.statistics).__name__}")

    @classmethod
    def of(cls, endpoint: Endpoint, options: Mapping[str, Any], **usual: Any) -> CheckedOptions:
        """
        Return the options of an endpoint's URL and the given ones, which take precedence.

        Raises:
            TypeError, ValueError: an option of the wrong name, type or range.
        """
        names = [field.name for field in fields(cls)]
        known = [name for name in names if name not in OF_ASYNC_CLIENTS or name in usual]
        for name in (*endpoint.client_options, *options):
            if name not in known:
                serial = SERIAL_OPTIONS if endpoint.is_serial and "may_send" not in usual else ()
                raise unknown_option(name, [*known, *serial])
        settings = cls(**{**usual, **endpoint.client_options, **options})
        if not endpoint.has_transactions:
            where = f"on {endpoint.scheme}, whose answers carry no transaction id"
            if settings.max_in_flight != 1:
                raise ValueError(f"max_in_flight must be 1 {where}")
            if settings.accept_unit != "same":
                raise ValueError(f'accept_unit must be "same" {where}')
        return settings

    @property
    def timeouts(self) -> Timeouts:
        return Timeouts(float(self.timeout), self.retries, self.busy_retries)
