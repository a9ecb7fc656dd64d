"""
The TCP connections of a server: who may come, who may stay, who must go.

asyncio's transports buffer what they like and accept whoever comes; here every
connection costs what `Limits` says at most. All of them wait in one epoll, and it alone
in the loop. In a turn each is read once, and then all answers are sent: requests of many
connections can be answered together, and who has many is woken once, not for each answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import os
import select
import socket
from collections.abc import Callable
from heapq import nsmallest
from select import EPOLLIN, EPOLLOUT

from ..protocol.errors import FrameError
from .by_frame import Session
from .limits import SPARE_DESCRIPTORS, Allowance, Limits, ServerStatistics

__all__ = ["MakeSession", "Peer", "Peers"]

logger: logging.Logger = logging.getLogger(__name__)

# How much of one client is read in a turn: the others wait while it is answered. One that
# sends more than the first is read only when all others are answered, and then more of it.
FAIR_SIZE = 256
READ_SIZE = 1024

# How many of them in a turn: serial ports and newcomers have theirs.
EVENTS_MAX = 128

# How many of those that send more than FAIR_SIZE.
GREEDY_AT_ONCE = 2

# Room for more descriptors than that is made when they come.
ROOM_AT_MOST = 16_384

# What is idle is known that exactly: to note it for each request would cost more
# than to read the request.
RESOLUTION = 0.05

MakeSession = Callable[["Peer"], Session]
"""Makes the session of a connection."""


class Peers:
    """The connections of all TCP endpoints, within the limits."""

    def __init__(self, limits: Limits, statistics: ServerStatistics) -> None:
        self.limits = limits
        self.statistics = statistics
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self._most = limits.connections()
        # Both from the longest idle to the latest: those that never sent a request, and
        # the others.
        self._strangers: dict[Peer, float] = {}
        self._known: dict[Peer, float] = {}
        # Connections that must get on with something, and until when.
        self._deadlines: dict[Peer, float] = {}
        # Those that have something to send when all have been read.
        self._sending: list[Peer] = []
        # What is to be done before that.
        self._calls: list[Callable[[], None]] = []
        self._in_turn = False
        self._turns = 0
        self._now = 0.0  # the time of this turn
        self._epoll = select.epoll()
        _make_room_for_descriptors(self._epoll.fileno(), self._most)
        self._by_descriptor: dict[int, Peer] = {}
        self.loop.add_reader(self._epoll.fileno(), self._turn)
        self._sweeping: asyncio.TimerHandle | None = None
        timeouts = [limits.frame_timeout, limits.idle_timeout or limits.frame_timeout]
        self._sweep_every = max(0.01, min(1.0, *(timeout / 4 for timeout in timeouts)))

    def __len__(self) -> int:
        return len(self._strangers) + len(self._known)

    def admit(self, client: socket.socket, address: tuple[str, int], make: MakeSession) -> None:
        """Take charge of a new connection, or close it."""
        host, port = address[:2]
        if not self.limits.allows(host):
            self.statistics.disallowed += 1
            client.close()
        elif len(self) >= self._most and not self._make_room():
            self.statistics.refused_full += 1
            client.close()
        else:
            self._add(client, f"{host}:{port}", make)

    def close(self) -> None:
        if self._sweeping is not None:
            self._sweeping.cancel()
        for peer in [*self._strangers, *self._known]:
            peer.close()
        self.loop.remove_reader(self._epoll.fileno())
        self._epoll.close()

    def _add(self, client: socket.socket, address: str, make: MakeSession) -> None:
        with contextlib.suppress(OSError):  # it may be gone already
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.statistics.accepted += 1
        self.statistics.connections += 1
        self._strangers[Peer(self, client, address, make)] = self.loop.time()
        if self._sweeping is None:
            self._sweeping = self.loop.call_later(self._sweep_every, self._sweep)

    def _make_room(self) -> bool:
        if self.limits.when_full == "refuse":
            return False
        self.statistics.closed_for_others += 1
        next(iter(self._strangers or self._known)).close()
        return True

    def remove(self, peer: Peer) -> None:
        self.statistics.connections -= 1
        self._strangers.pop(peer, None)
        self._known.pop(peer, None)
        self._deadlines.pop(peer, None)

    # --- reading and writing ----------------------------------------------------------------

    def watch(self, peer: Peer, descriptor: int, events: int) -> None:
        """Tell a peer of these events from now on."""
        if descriptor in self._by_descriptor:
            self._epoll.modify(descriptor, events)
        else:
            self._by_descriptor[descriptor] = peer
            self._epoll.register(descriptor, events)

    def forget(self, descriptor: int) -> None:
        del self._by_descriptor[descriptor]
        self._epoll.unregister(descriptor)

    def later(self, call: Callable[[], None]) -> None:
        """Have it called when all have been read, before answers are sent."""
        if not self._calls and not self._in_turn:
            self.loop.call_soon(self._finish_turn)
        self._calls.append(call)

    def send_soon(self, peer: Peer) -> None:
        """Have it send when all have been read."""
        if not self._sending and not self._in_turn:
            self.loop.call_soon(self._send)
        self._sending.append(peer)

    def _turn(self) -> None:
        self._in_turn = True
        self._now = self.loop.time()
        greedy = []
        for descriptor, events in self._epoll.poll(0, EVENTS_MAX):
            # Another one's turn may have closed it.
            if peer := self._by_descriptor.get(descriptor):
                if peer.is_greedy:
                    greedy.append((peer, events))
                else:
                    peer.act(events)
        self._finish_turn()
        if greedy:
            self._turns += 1
            for peer, events in nsmallest(GREEDY_AT_ONCE, greedy, key=_latest_turn):
                peer.latest_turn = self._turns
                peer.act(events)
            self._finish_turn()
        self._in_turn = False

    def _finish_turn(self) -> None:
        calls, self._calls = self._calls, []
        for call in calls:
            try:
                call()
            except Exception:  # a mistake of ours must not end all turns
                logger.exception("requests are lost")
        self._send()

    def _send(self) -> None:
        sending, self._sending = self._sending, []
        for peer in sending:
            peer.send()

    # --- who is idle, who is late --------------------------------------------------------

    def note_request(self, peer: Peer) -> None:
        """It is the latest of all now, and no frame is begun."""
        self._deadlines.pop(peer, None)
        if self._now - self._known.get(peer, 0.0) > RESOLUTION:
            self._strangers.pop(peer, None)
            self._known.pop(peer, None)
            self._known[peer] = self._now

    def set_deadline(self, peer: Peer) -> None:
        """From now on, unless there is one already."""
        self._deadlines.setdefault(peer, self.loop.time() + self.limits.frame_timeout)

    def drop_deadline(self, peer: Peer) -> None:
        self._deadlines.pop(peer, None)

    def _sweep(self) -> None:
        self._sweeping = None
        now = self.loop.time()
        for peer in _due(self._deadlines, now):
            self.statistics.closed_slow += 1
            peer.close()
        if self.limits.idle_timeout is not None:
            for table in (self._strangers, self._known):
                for peer in _due(table, now - self.limits.idle_timeout):
                    self.statistics.closed_idle += 1
                    peer.close()
        if len(self):
            self._sweeping = self.loop.call_later(self._sweep_every, self._sweep)


def _make_room_for_descriptors(descriptor: int, most: int) -> None:
    """
    Let the system's table grow now: while it grows in a process with threads, whoever
    needs a new descriptor waits 10 ms (synchronize_rcu), and all clients with it.
    """
    highest = min(most, ROOM_AT_MOST) + SPARE_DESCRIPTORS // 2
    with contextlib.suppress(OSError):
        os.close(fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, highest))


def _latest_turn(ready: tuple[Peer, int]) -> int:
    return ready[0].latest_turn


def _due(times: dict[Peer, float], until: float) -> list[Peer]:
    """The first ones, for their times are in order."""
    due = []
    for peer, time in times.items():
        if time > until:
            break
        due.append(peer)
    return due


class Peer:
    """One client. It is read only while it takes its answers and is not throttled."""

    # fmt: off
    __slots__ = (
        "_allowance", "_descriptor", "_is_closing", "_is_full", "_is_reading", "_is_sending",
        "_is_throttled", "_loop", "_peers", "_release_timer", "_session", "_socket", "_unsent",
        "address", "is_greedy", "latest_turn", "role",
    )
    # fmt: on

    def __init__(
        self, peers: Peers, client: socket.socket, address: str, make: MakeSession
    ) -> None:
        self.address: str = address
        self.role: str | None = None  # known to a session within TLS only
        self._peers = peers
        self._loop = peers.loop
        self._socket = client
        self._descriptor = client.fileno()
        # bytes as long as the client takes them at once: mostly one answer, never copied.
        self._unsent: bytes | bytearray = b""
        self.is_greedy: bool = False  # whether there was more than was read
        self.latest_turn: int = 0
        self._is_sending = self._is_full = self._is_throttled = self._is_closing = False
        self._is_reading = True
        self._release_timer: asyncio.TimerHandle | None = None
        rate = peers.limits.requests_per_second
        self._allowance = None if rate is None else Allowance(rate, self._loop.time())
        self._session = make(self)
        peers.watch(self, self._descriptor, EPOLLIN)

    def close(self) -> None:
        """Close at once. Any number of times."""
        if self._descriptor < 0:
            return
        self._session.close()
        del self._session  # which knows us: a circle would have to be looked for (gc)
        if self._release_timer is not None:
            self._release_timer.cancel()
        self._peers.forget(self._descriptor)
        self._descriptor = -1
        if self._unsent:  # its last words, if they go
            with contextlib.suppress(OSError):
                self._socket.send(self._unsent)
        self._socket.close()
        self._peers.remove(self)

    def act(self, events: int) -> None:
        """Do what can be done now."""
        try:
            if events & EPOLLIN:
                self._read()
            elif events & (select.EPOLLHUP | select.EPOLLERR):
                self.close()
            if events & EPOLLOUT:
                self.send()
        except Exception:  # a mistake of ours must not cost the others their turn
            logger.exception("%s: connection closed", self.address)
            self.close()

    def _read(self) -> None:
        try:
            size = READ_SIZE if self.is_greedy else FAIR_SIZE
            data = self._socket.recv(size)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self.close()
            return
        if not data:  # it will not ask any more, but may still listen
            self.end()
            return
        self.is_greedy = len(data) == size
        self._receive(self._session.receive, data)

    def go_on(self, receive: Callable[[], int]) -> None:
        """Let the session receive what it had put off; as when it comes."""
        try:
            self._receive(receive)
        except Exception:  # as in `act`
            logger.exception("%s: connection closed", self.address)
            self.close()

    def _receive(self, receive: Callable[..., int], *data: bytes) -> None:
        peers, session = self._peers, self._session
        try:
            requests = receive(*data)
        except FrameError as error:
            logger.debug("%s: connection closed: %s", self.address, error)
            peers.statistics.closed_out_of_step += 1
            self.end()
            return
        if requests:
            peers.note_request(self)
            if self._allowance is not None:
                self._throttle(requests, self._allowance)
        if session.is_unfinished and self._is_reading:
            peers.set_deadline(self)

    # --- answers ------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        if not self._unsent:
            self._peers.send_soon(self)
        self._unsent += data
        if self._is_sending:
            self._pause_if_full()

    def send(self) -> None:
        """Send what the client takes, and the rest when it takes more."""
        if self._descriptor < 0:
            return
        try:
            sent = self._socket.send(self._unsent)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError:
            self.close()
            return
        if sent < len(self._unsent):
            self._wait_to_send(sent)
        else:
            self._unsent = b""
            if self._is_sending:
                self._finish_sending()
        if self._is_closing and not self._unsent:
            self.close()

    def _wait_to_send(self, sent: int) -> None:
        self._unsent = bytearray(self._unsent[sent:])
        if not self._is_sending:
            self._is_sending = True
            self._watch()
        self._pause_if_full()

    def _pause_if_full(self) -> None:
        if len(self._unsent) > self._peers.limits.max_unsent and not self._is_full:
            self._is_full = True
            self._peers.statistics.paused += 1
            self.follow()

    def _finish_sending(self) -> None:
        self._is_sending = self._is_full = False
        self._watch()
        self.follow()

    def end(self) -> None:
        if not self._unsent:
            self.close()
            return
        self._is_closing = True
        self.follow()
        self._peers.set_deadline(self)

    # --- reading or not -------------------------------------------------------------------

    def _throttle(self, requests: int, allowance: Allowance) -> None:
        allowance.spend(requests)
        if wait := allowance.wait(self._loop.time()):
            self._peers.statistics.throttled += 1
            self._is_throttled = True
            self.follow()
            self._release_timer = self._loop.call_later(wait, self._release)

    def _release(self) -> None:
        self._is_throttled = False
        self.follow()

    def follow(self) -> None:
        """Read, or do not read, as things are now."""
        if self._descriptor < 0:
            return
        read = not (
            self._is_full or self._is_throttled or self._is_closing or self._session.is_waiting
        )
        if read != self._is_reading:
            self._is_reading = read
            self._watch()
            # The time of a frame is not running while nobody reads it.
            if not read:
                self._peers.drop_deadline(self)
            elif self._session.is_unfinished:
                self._peers.set_deadline(self)

    def _watch(self) -> None:
        events = EPOLLIN * self._is_reading | EPOLLOUT * self._is_sending
        self._peers.watch(self, self._descriptor, events)
