"""
The blocking client: a context for each kind of endpoint.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar, Unpack, overload

from ..ports.schemes import DEFAULT_PORT, PARITIES, SECURE_PORT, SERIAL_OPTIONS, Scheme
from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import InvalidResponse, ModbusError
from .batch import MAX_IN_FLIGHT, Batch, raised
from .blocking_driver import BlockingDriver
from .handle import Handle
from .polling import Polls, interval_of, watched
from .procedures import ChangeRegister, Several
from .requests import Blocking

if TYPE_CHECKING:
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
    from ..ports.endpoint import Endpoint
    from ..ports.serial import LineSettings, SerialSettings
    from .options import ContextOptions

    class RtuOptions(ContextOptions, LineSettings, total=False):
        """The options of contexts on a serial line."""

    class UrlOptions(ContextOptions, SerialSettings, total=False):
        """The options of a context of any kind."""


__all__ = [
    "AsciiContext",
    "Client",
    "Context",
    "RtuContext",
    "TcpContext",
    "TlsContext",
    "UdpContext",
]

Result = TypeVar("Result")


class Context(Handle[BlockingDriver], Blocking):
    """
    A client of one unit: `TcpContext`, `TlsContext`, `UdpContext`, `RtuContext`, `AsciiContext`.

    Connects when entered (``with``) or used, again on the next request after the
    connection was lost or counts as dead, and closes on exit. Safe from any thread: one
    request at a time, the others wait. After a fork the child connects anew and the
    parent notices nothing. Ctrl-C takes effect at once.

    Addresses are 0-based, 0..65535; times are in seconds; the options are those of
    `client.options.ContextOptions`.

    Every request raises, apart from what its method names:

    * TypeError, ValueError: an argument, named with its range; nothing was sent. Contexts
      raise them, too, when they are made.
    * ExceptionResponse: the server refused; the subclass says why.
    * ModbusTimeoutError: no complete answer within `timeout`.
    * ModbusConnectionError: no connection, or it was lost meanwhile, with errno.
    * FrameError, InvalidResponse: the answer was none.
    * RuntimeError: from a signal handler or callback within a request of this thread.

    After a request without a good answer, a unit on a serial line is only asked again when the
    line has been silent for `timeout`: an answer that is still to come would be taken for that
    to the next request. Other units need not wait for that.

    Every answer is checked in full: id, unit, function, length, byte count, echo. With `native`
    a request that libmodbus knows is sent and its answer awaited in one call of C,
    without the GIL; on serial lines libmodbus sends it.
    """

    # Scheme -> the class that `from_url` makes.
    _kinds: ClassVar[dict[str, type[Context]]] = {}

    def __init_subclass__(cls, schemes: Iterable[Scheme] = (), **others: Any) -> None:
        super().__init_subclass__(**others)
        Context._kinds.update(dict.fromkeys(schemes, cls))

    def __init__(self, endpoint: Endpoint, options: Mapping[str, Any]) -> None:
        # Imported here, because the parts of a client take longer to import than this module, and
        # some programs make no client.
        from .options import CheckedOptions, assembled

        settings = CheckedOptions.of(endpoint, options, native=True)
        parts = assembled(endpoint, settings, MAX_IN_FLIGHT)
        # ASCII, echoes and pauses are for the conversation.
        is_paced = settings.request_spacing or settings.connect_delay
        is_plain = endpoint.framing != "ascii" and not endpoint.options.get("echo")
        driver = BlockingDriver(parts, settings.native, is_plain and not is_paced)
        super().__init__(parts, settings, driver)

    @staticmethod
    def from_url(address: str, **options: Unpack[UrlOptions]) -> Context:
        """
        Make the context for a URL (`libmodbus_py.ports.endpoint`).

        Args:
            address: such as "tcp://192.0.2.10?unit=17" or "rtu:///dev/ttyUSB0?baudrate=9600".
            options: as for the class; they win over those of the URL.

        Raises:
            TypeError, ValueError: the URL or an option is wrong.
        """
        endpoint, others = _parsed(address, options)
        kind = Context._kinds[endpoint.scheme]
        context = kind.__new__(kind)
        Context.__init__(context, endpoint, others)
        return context

    def connect(self) -> None:
        """
        Connect, unless connected. Requests do so by themselves.

        Raises:
            ModbusConnectionError: with errno.
        """
        batch = Batch(self.unit, [], self._timeouts)
        self._driver.run(batch)
        if batch.refusal is not None:
            raise batch.refusal

    def close(self) -> None:
        """
        Close for good; may be called any number of times, from any thread and signal handler.

        Requests that wait for an answer or a connection fail at once.
        """
        self._driver.close()

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def execute(
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
        result: Result = self._driver.ask(self._unit, request, timeouts, is_broadcast)
        return result

    @overload
    def read_many(  # type: ignore[overload-overlap]  # mappings first
        self, items: Named[Key], **options: Unpack[Strict]
    ) -> dict[Key, Values]: ...
    @overload
    def read_many(  # type: ignore[overload-overlap]
        self, items: Named[Key], **options: Unpack[Tolerant]
    ) -> dict[Key, Values | ModbusError]: ...
    @overload
    def read_many(self, items: Iterable[Item], **options: Unpack[Strict]) -> list[Values]: ...
    @overload
    def read_many(
        self, items: Iterable[Item], **options: Unpack[Tolerant]
    ) -> list[Values | ModbusError]: ...
    @overload
    def read_many(
        self, items: Plan, *, max_in_flight: int = 16, return_exceptions: bool = False
    ) -> Any: ...
    def read_many(
        self,
        items: Plan | Items,
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
        **options: Unpack[PlanOptions],
    ) -> Any:
        return self._read_many(items, max_in_flight, return_exceptions, options)

    @overload
    def watch(
        self,
        what: RegisterMap,
        *,
        every: float,
        names: Iterable[str] | None = None,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[PolledValues]: ...
    @overload
    def watch(  # type: ignore[overload-overlap]
        self,
        what: Named[Key],
        *,
        every: float,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[dict[Key, Values | ModbusError]]: ...
    @overload
    def watch(
        self,
        what: Iterable[Item],
        *,
        every: float,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[list[Values | ModbusError]]: ...
    @overload
    def watch(self, what: Plan, *, every: float, max_in_flight: int = 16) -> Polls[Any]: ...
    def watch(
        self,
        what: RegisterMap | Plan | Items,
        *,
        every: float,
        names: Iterable[str] | None = None,
        max_in_flight: int = 16,
        **options: Unpack[PlanOptions],
    ) -> Polls[Any]:
        interval = seconds("every", every, 0.01)
        polled = watched(what, names, interval, options)
        integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        return Polls(
            interval_of(polled, interval),
            lambda at: self._poll(polled, max_in_flight, at),
            self._driver.now,
            self._driver.wait_until,
            lambda: self.closed,
        )

    def _follow(self, make: Any, arguments: Any, named: Any) -> Any:
        """Carry out a procedure."""
        steps = make(self, *arguments, **named)
        try:
            step = next(steps)
            while True:
                step = steps.send(self._take(step))
        except StopIteration as done:
            return done.value
        except InvalidResponse as error:
            raise self._named(error) from None

    def _take(self, step: pdu.Request[Any] | Several | ChangeRegister) -> Any:
        if isinstance(step, ChangeRegister):
            with self._driver.lock:  # requests of other threads wait
                (register,) = self.execute(pdu.ReadHoldingRegisters(step.request.address, 1))
                return self.execute(step.write(register))
        if not isinstance(step, Several):
            return self.execute(step)
        batch = self._batch(step.requests, step.max_in_flight, step.return_exceptions)
        if batch.pdus:
            self._driver.run(batch)
        raised(batch.outcomes, step.returned)
        return batch.outcomes


class Client(Context):
    """
    A client for any URL: what `AsyncClient` is with ``await``.

    Args:
        url: such as "tcp://192.0.2.10?unit=17" or "rtu:///dev/ttyUSB0?baudrate=9600"
            (`libmodbus_py.ports.endpoint`).
        options: those of `TcpContext`, or on a serial line of `RtuContext`; they take
            precedence over those of the URL.

    Raises:
        TypeError, ValueError: the URL or an option is wrong.
    """

    def __init__(self, url: str, **options: Unpack[UrlOptions]) -> None:
        super().__init__(*_parsed(url, options))


class TcpContext(Context, schemes=("tcp", "rtu+tcp", "ascii+tcp")):
    """
    A client over TCP.

    Args:
        host: a name with all its addresses, an IPv4 or an IPv6 address; the port may be in it, as
            in "192.0.2.1:1502".
        port: 1..65535.
        framing: "tcp" (MBAP); "rtu" or "ascii" for such a line behind a
            serial device server.
        options: `unit`, `timeout` and others; see `client.options.ContextOptions`.
    """

    def __init__(
        self,
        host: str,
        port: int = DEFAULT_PORT,
        *,
        framing: Literal["tcp", "rtu", "ascii"] = "tcp",
        **options: Unpack[ContextOptions],
    ) -> None:
        if framing not in ("tcp", "rtu", "ascii"):
            raise ValueError(f"framing must be one of tcp, rtu, ascii, not {framing!r}")
        scheme = framing if framing == "tcp" else f"{framing}+tcp"
        super().__init__(_at(scheme, host, port, DEFAULT_PORT), options)


class TlsContext(Context, schemes=("tls",)):
    """
    A client over TLS: Modbus Security. Both sides prove who they are by certificates.

    A refused certificate is a ModbusConnectionError (errno EKEYREJECTED) that says which and
    why: the server's when connecting, one's own at the first request, if the server
    speaks TLS 1.3.

    Args:
        host: a name with all its addresses, an IPv4 or an IPv6 address; the port may be in it, as
            in "192.0.2.1:1502".
        port: 1..65535.
        options: `security`, which it needs, `unit`, `timeout` and others; see
            `client.options.ContextOptions`.
    """

    def __init__(
        self, host: str, port: int = SECURE_PORT, **options: Unpack[ContextOptions]
    ) -> None:
        super().__init__(_at("tls", host, port, SECURE_PORT), options)


class UdpContext(Context, schemes=("udp", "rtu+udp")):
    """
    A client over UDP: the frames of Modbus/TCP, each in a datagram.

    The network may lose or double datagrams. A request that gets no answer is a
    ModbusTimeoutError; `retries` sends those again that may be carried out twice.
    Datagrams of other hosts do not end the wait, and neither do damaged ones; with the frames
    of RTU, a damaged answer ends it, as it does on a serial line.

    Args:
        host: a name, an IPv4 or an IPv6 address; the port may be in it, as in "192.0.2.1:1502".
        port: 1..65535.
        options: `unit`, `timeout` and others; see `client.options.ContextOptions`.
    """

    def __init__(
        self, host: str, port: int = DEFAULT_PORT, **options: Unpack[ContextOptions]
    ) -> None:
        super().__init__(_at("udp", host, port, DEFAULT_PORT), options)


class RtuContext(Context, schemes=("rtu",)):
    """
    A client on a serial line in RTU mode; libmodbus opens, configures and sends.

    Args:
        device: such as "/dev/ttyUSB0"; locked while open, so that no two
            programs talk at once.
        baudrate: bits per second.
        options: `unit`, `timeout` and others, see `client.options.ContextOptions`; and
            `parity` ("E"), `data_bits` (8), `stop_bits` (1), `rs485`, `rts_delay`, `echo` and
            `silence`, see `ports.serial.SerialPort`. Let `timeout` be more than the
            slowest unit needs, for a late answer cannot be told from the next one.
    """

    def __init__(self, device: str, baudrate: int = 19200, **options: Unpack[RtuOptions]) -> None:
        super().__init__(*_on_line("rtu", device, baudrate, options))


class AsciiContext(Context, schemes=("ascii",)):
    """
    A client on a serial line in ASCII mode, which libmodbus lacks.

    libmodbus opens and configures the port; this package does the talking.
    Arguments as for `RtuContext`, but `data_bits` is 7 and `silence` 0 by default: ASCII
    frames have marks of their own.
    """

    def __init__(self, device: str, baudrate: int = 19200, **options: Unpack[RtuOptions]) -> None:
        super().__init__(*_on_line("ascii", device, baudrate, options))


def _parsed(url: str, options: UrlOptions) -> tuple[Endpoint, Mapping[str, Any]]:
    """Return the endpoint of a URL, with the options that are of a serial port, and the others."""
    from dataclasses import replace

    from ..ports.endpoint import parse

    endpoint = parse(url)
    if not endpoint.is_serial:
        return endpoint, options
    settings, others = _split(options)
    return replace(endpoint, options={**endpoint.options, **settings}), others


def _split(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the options of a serial port, and those of the client."""
    settings: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, value in options.items():
        (settings if name in SERIAL_OPTIONS else others)[name] = value
    if isinstance(parity := settings.get("parity"), str):
        settings["parity"] = PARITIES.get(parity.lower(), parity)
    return settings, others


def _at(scheme: Any, host: str, port: int, usual: int) -> Endpoint:
    """
    Return an endpoint of a network; a host such as 192.0.2.1:1502 or [::1]:1502 contains its port.

    Raises:
        ValueError: the host is a URL, or two ports are given.
    """
    if isinstance(host, str) and (":" in host or "/" in host):
        if "/" in host:
            raise ValueError(f"host must be a name or an address, not {host!r}; Client takes URLs")
        if found := re.fullmatch(r"\[([^\]]+)\](?::([0-9]{1,5}))?|([^:]+):([0-9]{1,5})", host):
            text = found[2] or found[4]
            if text is not None and port not in (usual, int(text)):
                raise ValueError(f"host {host!r} contains another port than {port}")
            host, port = found[1] or found[3], port if text is None else int(text)
    return _endpoint(scheme, host=host, port=port)


def _endpoint(scheme: Any, **where: Any) -> Endpoint:
    from ..ports.endpoint import Endpoint

    return Endpoint(scheme, **where)


def _on_line(
    scheme: Literal["rtu", "ascii"], device: str, baudrate: int, options: RtuOptions
) -> tuple[Endpoint, Mapping[str, Any]]:
    settings, others = _split(options)
    return _endpoint(scheme, device=device, options={"baudrate": baudrate, **settings}), others
