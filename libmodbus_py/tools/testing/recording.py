"""
Servers for tests: they serve in the background, and keep what passed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from typing import Self, TypedDict, Unpack

from ...device.device import Device
from ...device.mapping import Mapping as Tables
from ...ports.endpoint import Endpoint, parse
from ...protocol.tables import TABLE_SIZE
from ...security.security import Security
from ...server.faults.fault import Fault
from ...server.faults.switch import FaultSwitch
from ...server.limits import Limits, ServerStatistics
from ...server.server import Server
from ...server.units import UnknownUnit
from ..listener.transaction import Transaction
from .exchanges import Exchanges

__all__ = ["RecordingServer", "ServerMaker", "ServerOptions"]

USUAL_URL = "tcp://127.0.0.1:0"


class ServerOptions(TypedDict, total=False):
    """What else `Server` takes, and means there."""

    limits: Limits | None
    unknown_unit: UnknownUnit
    own_unit: int | None
    security: Security | None


class RecordingServer:
    """
    A server, from the moment it is made until `close`.

    Args, exceptions: those of `Server` and of its `background`.

    Attributes:
        urls: of its endpoints, in the order given, with the ports they got; a client takes
            those of networks as they are.
        url: the first of them.
        host, port: of the first endpoint; "" and 0 for serial ports.
        device: the device that answers, or None if there are several.
        faults: switches on what goes wrong.
        statistics: what happened, counted.
    """

    def __init__(
        self,
        urls: Iterable[str],
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None,
        **options: Unpack[ServerOptions],
    ) -> None:
        self._exchanges = Exchanges()
        server = Server(devices, faults, trace=self._exchanges.note, **options)
        self.device: Device | None = _only(devices)
        self.faults: FaultSwitch = server.fault_switch
        self.statistics: ServerStatistics = server.statistics
        self._stack = contextlib.ExitStack()
        self.urls: list[str] = self._stack.enter_context(server.background(*urls)).urls
        self.url: str = self.urls[0]

    @property
    def host(self) -> str:
        return self._endpoint.host

    @property
    def port(self) -> int:
        return self._endpoint.port

    @property
    def mapping(self) -> Tables:
        """
        The four tables of the device.

        Raises:
            AttributeError: there are several devices; each has a mapping.
        """
        if self.device is None:
            raise AttributeError("this server has several devices: each has a mapping of its own")
        return self.device.mapping

    @property
    def transactions(self) -> list[Transaction]:
        """The last 10 000 or so transactions, in the order of the requests."""
        return self._exchanges.transactions()

    def close(self) -> None:
        """Stop, and close all connections; any number of times. What it recorded stays."""
        self._stack.close()

    @property
    def _endpoint(self) -> Endpoint:
        return parse(self.url)


def _only(devices: Device | Mapping[int, Device]) -> Device | None:
    if isinstance(devices, Device):
        return devices
    return next(iter(devices.values())) if len(devices) == 1 else None


class ServerMaker:
    """
    Makes servers, and closes them all when it is left.

    Attributes:
        servers: those that it made, in order.
    """

    def __init__(self) -> None:
        self.servers: list[RecordingServer] = []

    def __call__(
        self,
        *urls: str,
        devices: Device | Mapping[int, Device] | None = None,
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
        **options: Unpack[ServerOptions],
    ) -> RecordingServer:
        """
        Make a server, which serves when this returns.

        Args:
            urls: where to listen, as of `Server.serving`; none for a free port of 127.0.0.1
                with Modbus/TCP.
            devices: as of `Server`; None for one that answers every unit and has all four
                tables, addresses 0..65535, all zero.
            faults: as of `Server`.
            options: as of `Server`.

        Raises:
            TypeError, ValueError: an argument of the wrong type or range.
            ModbusConnectionError: an endpoint cannot be opened, with errno.
        """
        if devices is None:
            devices = Device(Tables(TABLE_SIZE, TABLE_SIZE, TABLE_SIZE, TABLE_SIZE))
        made = RecordingServer(urls or (USUAL_URL,), devices, faults, **options)
        self.servers.append(made)
        return made

    def close(self) -> None:
        """Close all that were made, the last one first; what they recorded stays."""
        with contextlib.ExitStack() as stack:
            for each in self.servers:
                stack.callback(each.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
