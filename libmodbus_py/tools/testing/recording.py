"""Servers for tests: they serve in the background, and record their transactions."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Self, TypedDict, Unpack

from ...device.device import Device
from ...device.mapping import Mapping as Tables
from ...ports.endpoint import parse
from ...ports.trace import TracedFrame
from ...protocol.tables import TABLE_SIZE
from ...security.security import Security
from ...server.faults import FaultSwitch, ServerFault
from ...server.limits import Limits, ServerStatistics
from ...server.server import Server
from ...server.units import UnknownUnit
from ..listener.pairing import TracePairing
from ..listener.transaction import Transaction

MOST = 20_000
"""ADUs of one server that are kept: more than a test needs, and a limit for long runs."""

USUAL_URL = "tcp://127.0.0.1:0"


class ServerOptions(TypedDict, total=False):
    """The other arguments of `Server`."""

    limits: Limits | None
    unknown_unit: UnknownUnit
    own_unit: int | None
    security: Security | None


class RecordingServer:
    """
    A server that runs in the background until `close`, and records its transactions.

    Its arguments and exceptions are those of `Server` and of `Server.background`.

    Attributes:
        urls: the URLs of its endpoints, in the order given, with the ports that the system chose;
            those of networks are also URLs for clients.
        url: the first of `urls`.
        host, port: the host and port of the first endpoint; "" and 0 for serial ports.
        device: the device that answers, or None if there are several.
        faults: switches faults of the server on and off.
        statistics: counters of the server.
    """

    def __init__(
        self,
        urls: Iterable[str],
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[ServerFault]] | None,
        **options: Unpack[ServerOptions],
    ) -> None:
        # Paired only when `transactions` is called, so that this does not slow down the server.
        self._traces: deque[TracedFrame] = deque(maxlen=MOST)
        server = Server(devices, faults=faults, trace=self._traces.append, **options)
        self.device: Device | None = devices if isinstance(devices, Device) else None
        if isinstance(devices, Mapping) and len(devices) == 1:
            (self.device,) = devices.values()
        self.faults: FaultSwitch = server.fault_switch
        self.statistics: ServerStatistics = server.statistics
        self._stack = contextlib.ExitStack()
        self.urls: list[str] = self._stack.enter_context(server.background(*urls)).urls
        self.url: str = self.urls[0]

    @property
    def host(self) -> str:
        return parse(self.url).host

    @property
    def port(self) -> int:
        return parse(self.url).port

    @property
    def mapping(self) -> Tables:
        """
        The four tables of the device.

        Raises:
            AttributeError: the server has several devices, each with a mapping.
        """
        if self.device is None:
            raise AttributeError("this server has several devices, each with its own mapping")
        return self.device.mapping

    @property
    def transactions(self) -> list[Transaction]:
        """The last 10 000 or so transactions, in the order in which they began."""
        pairing = TracePairing(timeout=math.inf)
        for frame in self._traces.copy():
            pairing.take(frame)
        pairing.end()
        return sorted((row.transaction for row in pairing.done), key=attrgetter("time"))

    def close(self) -> None:
        """Stop, and close all connections. May be called repeatedly. The transactions are kept."""
        self._stack.close()


class ServerMaker:
    """
    Makes servers, and closes all of them at the end of its ``with`` block.

    Attributes:
        servers: all servers that were made, in order.
    """

    def __init__(self) -> None:
        self.servers: list[RecordingServer] = []

    def __call__(
        self,
        *urls: str,
        devices: Device | Mapping[int, Device] | None = None,
        faults: Mapping[int | None, Iterable[ServerFault]] | None = None,
        **options: Unpack[ServerOptions],
    ) -> RecordingServer:
        """
        Start a new server, and return it.

        Args:
            urls: the endpoints, as for `Server.serving`; by default Modbus/TCP on a free port of
                127.0.0.1.
            devices: as for `Server`; None for a device that answers every unit and has all
                addresses 0..65535 of the four tables, all zero.
            faults: as for `Server`.
            options: as for `Server`.

        Raises:
            TypeError, ValueError: an argument is of the wrong type or out of range.
            ModbusConnectionError: an endpoint cannot be opened, with errno.
        """
        if devices is None:
            devices = Device(Tables(TABLE_SIZE, TABLE_SIZE, TABLE_SIZE, TABLE_SIZE))
        server = RecordingServer(urls or (USUAL_URL,), devices, faults, **options)
        self.servers.append(server)
        return server

    def close(self) -> None:
        """Close all servers, the last one first; their transactions are kept."""
        with contextlib.ExitStack() as stack:
            for server in self.servers:
                stack.callback(server.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
