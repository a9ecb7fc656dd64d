"""The network of a simulated world: hosts and lines by name, and the package made to use them."""

import asyncio
import contextlib
import errno
import itertools
import random
import socket
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, TypeVar
from unittest.mock import patch

from libmodbus_py.client import handle
from libmodbus_py.client.history import forget_lines
from libmodbus_py.ports import tls
from libmodbus_py.ports.endpoint import Endpoint, parse
from libmodbus_py.ports.port import Port
from libmodbus_py.protocol.errors import ModbusConnectionError
from libmodbus_py.server import peers, serving, udp
from libmodbus_py.server import serial as serial_server
from libmodbus_py.server.peers import Peers
from libmodbus_py.services.fleet import fleet
from libmodbus_py.services.fleet.journal import journal_file
from libmodbus_py.services.gateway import gateway

from .events import Events
from .lines import MemorySerialPort, SerialLine
from .loop import Descriptors, VirtualLoop, run
from .ports import MemoryWaker, memory_port
from .processes import HOST, StoppableLoop
from .sockets import DELAY, MemoryDatagrams, MemoryEpoll, MemoryListener, MemorySocket, pair

Result = TypeVar("Result")

Accept = Callable[[MemorySocket, tuple[str, int]], object]
"""Takes the server's end of a new connection, and the address of its client."""

Tap = Callable[[str, int, bool, bytes], object]

ADDRESS = tuple[str, int]

# The time of day when the clock of the events stands at 0.
EPOCH = 1_700_000_000.0

# How long it takes to connect.
CONNECTING = 0.0003


class Network:
    """Hosts and lines in memory; the seed decides all that happens."""

    def __init__(self, seed: int = 0) -> None:
        forget_lines()  # which belong to another clock
        self.events: Events = Events(seed)
        self._seed = seed
        self.descriptors: Descriptors = Descriptors()
        self.lines: dict[str, SerialLine] = {}
        self.unreachable: set[str] = set()  # hosts that answer no attempt to connect
        self.tap: Tap | None = None  # place, connection (0 on lines), is it a client, what is sent
        self.has_processes: bool = False  # see `processes`
        self._hosts: dict[tuple[str, ADDRESS], tuple[Accept, str]] = {}
        self._datagrams: dict[ADDRESS, MemoryDatagrams] = {}
        self._sockets: dict[int, MemorySocket] = {}
        self._ports = 49_152
        self._connections = itertools.count(1)

    def loop(self) -> VirtualLoop:
        """Return a new event loop on this network."""
        kind = StoppableLoop if self.has_processes else VirtualLoop
        return kind(self.events, self.descriptors)

    def run(self, main: Callable[[], Coroutine[Any, Any, Result]]) -> Result:
        """
        Run a coroutine function in an event loop of its own, with the package on this network.
        """
        with self.installed():
            return run(main(), self.loop())

    def time_of_day(self) -> float:
        """Return what `time.time` does, in this world."""
        return EPOCH + self.events.now

    def new_port(self) -> int:
        """Return a number of a port that nobody has."""
        self._ports += 1
        return self._ports

    # --- who listens --------------------------------------------------------------------------

    def listen(self, url: str, accept: Accept) -> str:
        """Accept connections to a URL, or datagrams; return the URL with its port."""
        endpoint = parse(url)
        if not (endpoint.port or endpoint.has_path):
            endpoint = replace(endpoint, port=self.new_port())
        self._hosts[self._key(endpoint)] = accept, str(endpoint)
        return str(endpoint)

    def unlisten(self, url: str) -> None:
        """Refuse whoever connects to a URL from now on."""
        self._hosts.pop(self._key(parse(url)), None)

    def _key(self, endpoint: Endpoint) -> tuple[str, ADDRESS]:
        kind = "udp" if endpoint.transport == "udp" else "tcp"
        return kind, (endpoint.host or endpoint.path, endpoint.port)

    def line(self, device: str) -> SerialLine:
        """Return the line behind a device."""
        line = self.lines.get(device)
        if line is None:
            line = self.lines[device] = SerialLine(self.events)
            line.on_written = partial(self._note_written, device)
        return line

    # --- who connects -------------------------------------------------------------------------

    def connect(
        self, host: str, port: int, source: str | None = None
    ) -> tuple[MemorySocket | None, int]:
        """Connect over TCP, from an address or that of the process: see `ports.Connect`."""
        near, far = pair(self.events, self.descriptors)
        self.descriptors.writable.discard(near.fileno())
        if host not in self.unreachable:
            origin = source or HOST.get()
            self.events.after(CONNECTING, self._establish, near, far, (host, port), origin)
        return near, 0

    def _establish(
        self, near: MemorySocket, far: MemorySocket, address: ADDRESS, origin: str
    ) -> None:
        if near.is_closed:
            far.close()
            return
        accept, url = self._hosts.get(("tcp", address), (None, ""))
        if accept is None:
            near.refuse()
        else:
            near.note_room()
            self._sockets[far.fileno()] = far
            self._follow(near, far, url)
            near.address = (origin, self.new_port())
            accept(far, near.address)

    def _follow(self, near: MemorySocket, far: MemorySocket, place: str) -> None:
        number = next(self._connections)
        near.on_sent = partial(self._note_sent, place, number, True)
        far.on_sent = partial(self._note_sent, place, number, False)

    def _note_sent(self, place: str, number: int, is_client: bool, data: bytes) -> None:
        if self.tap is not None:
            self.tap(place, number, is_client, data)

    def _note_written(self, device: str, is_unit: bool, data: bytes) -> None:
        self._note_sent(device, 0, not is_unit, data)

    def open_datagrams(
        self, host: str, port: int, source: str | None = None
    ) -> tuple[MemorySocket | None, int]:
        """Return a socket whose datagrams go to a port."""
        near, far = pair(self.events, self.descriptors, is_datagram=True)
        accept, url = self._hosts.get(("udp", (host, port)), (None, ""))
        if accept is None:
            far.on_input = partial(near.reset, errno.ECONNREFUSED)
        else:
            self._follow(near, far, url)
            accept(far, (source or HOST.get(), self.new_port()))
        return near, 0

    def send_datagram(self, data: bytes, source: ADDRESS, target: ADDRESS) -> None:
        """Send a datagram that says it comes from there; nobody hears it where nobody listens."""
        self.events.after(DELAY, self._deliver, data, source, target)

    def _deliver(self, data: bytes, source: ADDRESS, target: ADDRESS) -> None:
        if (receiver := self._datagrams.get(target)) is not None:
            receiver.put(data, source)

    def waker(self) -> MemoryWaker:
        return MemoryWaker(self.events, self.descriptors)

    # --- in place of the system ---------------------------------------------------------------

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Let all clients and servers that are made meanwhile use this network."""
        with (
            patch.object(handle, "make_port", self._make_port),
            patch.object(peers, "bound", self._bound),
            patch.object(udp, "bound", self._bound),
            patch.object(serving, "Peers", partial(Peers, make_poller=self._epoll)),
            patch.object(serial_server, "SerialPort", self._serial),
            patch.object(gateway, "check_line", _any_line),
            # C knows no sockets in memory.
            # The phases of polls come of the time of day.
            patch.object(fleet, "time", SimpleNamespace(time=self.time_of_day)),
            patch.object(tls, "time", SimpleNamespace(monotonic=lambda: self.events.now)),
            patch.object(
                journal_file,
                "time",
                SimpleNamespace(time=self.time_of_day, monotonic=lambda: self.events.now),
            ),
            _seeded(self._seed),
        ):
            yield

    def _make_port(self, endpoint: Endpoint, settings: Any) -> Port:
        if endpoint.is_serial:
            return self._serial(endpoint.path, **endpoint.serial_settings)
        connect = self.open_datagrams if endpoint.is_datagram else self.connect
        address = endpoint.host or endpoint.path, endpoint.port
        port = memory_port(endpoint.transport).of(endpoint, settings)
        port.join(self.descriptors, partial(connect, *address), self.waker)
        return port

    def _serial(self, device: str, **settings: Any) -> MemorySerialPort:
        line = self.line(device)
        return MemorySerialPort(self.descriptors, line, self.waker, device, **settings)

    def _epoll(self) -> Any:
        return MemoryEpoll(self.descriptors, self._sockets)

    async def _bound(
        self, endpoint: Endpoint, kind: socket.SocketKind, make: Any
    ) -> tuple[list[Any], Endpoint]:
        await asyncio.sleep(0)
        target = replace(endpoint, port=endpoint.port or self.new_port())
        key = self._key(target)
        if key in self._hosts:
            raise ModbusConnectionError(
                f"cannot listen on {endpoint}: Address already in use", errno=errno.EADDRINUSE
            )
        if kind == socket.SOCK_DGRAM:
            return [self._listening_for_datagrams(key, str(target))], target
        listener = MemoryListener(self.descriptors, partial(self._hosts.pop, key, None))
        self._hosts[key] = listener.put, str(target)
        return [listener], target

    def _listening_for_datagrams(self, key: tuple[str, ADDRESS], url: str) -> MemoryDatagrams:
        address = key[1]
        ends: dict[ADDRESS, MemorySocket] = {}

        def accept(end: MemorySocket, source: ADDRESS) -> None:
            ends[source] = end
            end.on_input = partial(self._take_datagram, end, source, receiver)

        def send(data: bytes, target: ADDRESS) -> None:
            if target in ends:
                ends[target].send(data)
            else:
                self.send_datagram(data, address, target)

        def close() -> None:
            self._hosts.pop(key, None)
            self._datagrams.pop(address, None)
            for end in ends.values():
                end.on_input = partial(end.other.reset, errno.ECONNREFUSED)

        receiver = MemoryDatagrams(self.descriptors, send, close)
        self._hosts[key] = accept, url
        self._datagrams[address] = receiver
        return receiver

    def _take_datagram(self, end: MemorySocket, source: ADDRESS, receiver: MemoryDatagrams) -> None:
        while end.is_readable:
            receiver.put(end.recv(65_536), source)


@contextlib.contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Make random choices of the package, such as the pauses of clients, depend on the seed."""
    state = random.getstate()
    random.seed(seed)
    try:
        yield
    finally:
        random.setstate(state)


def _any_line(*_: object) -> None:
    """Take it that the device of each route exists, which the system is asked about otherwise."""
