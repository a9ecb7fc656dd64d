"""
A TCP connection of a server, and the turns in which all of them are read and answered.

asyncio's transports buffer without limit; here each connection costs at most what `Limits` allows.
All of them wait in one poller, and it alone in the loop. In a turn each is read once, and then all
answers are sent: requests of many connections can be answered together, and a client with many
connections is woken once, not for each answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import select
import socket
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from select import POLLERR, POLLHUP, POLLIN, POLLOUT
from typing import TYPE_CHECKING

from ..device.authorization import LimitedLog
from ..ports.trace import Trace
from ..protocol.errors import FrameError
from ..protocol.logs import HarmlessLogger
from .limits import Address, Limits, ServerStatistics
from .service import ENDS, TURN_EVENTS, UNREAD, Session, SessionState

if TYPE_CHECKING:
    from ..security.certificates import CertificateHolder

logger: HarmlessLogger = HarmlessLogger(__name__)

READ_BYTES = 512
"""Read from one client in a turn, during which the others wait: 42 requests for registers."""

UNFINISHED = SessionState.UNFINISHED

MakePeerSession = Callable[["Peer"], Session]
"""Makes the session of a connection."""


class Turns(ABC):
    """The turns of all connections, and the deadlines of their frames."""

    def __init__(
        self,
        limits: Limits,
        statistics: ServerStatistics,
        poller: select.epoll,
        log: LimitedLog,
    ) -> None:
        self.limits = limits
        self.statistics = statistics
        self.log: LimitedLog = log
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        # Connections with a deadline -> the time of the deadline.
        self.deadlines: dict[Peer, float] = {}
        # Connections that have something to send when all have been read.
        self._sending: list[Peer] = []
        # Functions to call before that.
        self._calls: list[Callable[[], None]] = []
        # Connections that have something to do without having received anything more.
        self._behind: deque[Peer] = deque()
        self._next_turn: asyncio.Handle | None = None
        self._ending: BaseException | None = None  # raised by a hook to end the program
        self._in_turn = False
        self.now: float = 0.0  # the time of this turn
        self._poller = poller
        self._by_descriptor: dict[int, Peer] = {}
        try:
            self.loop.add_reader(poller.fileno(), self._turn)
        except OSError:
            poller.close()
            raise

    @abstractmethod
    def remove(self, peer: Peer) -> None:
        """Note that a connection is closed."""

    @abstractmethod
    def end(self) -> None:
        """Close all endpoints of the server, because a hook ends the program."""

    def stop(self) -> None:
        if self._next_turn is not None:
            self._next_turn.cancel()
        if not self._poller.closed:
            self.loop.remove_reader(self._poller.fileno())
            self._poller.close()

    def abandon(self) -> None:
        for peer in list(self._by_descriptor.values()):
            peer.abandon()
        self._by_descriptor.clear()
        self._poller.close()

    def watch(self, peer: Peer, descriptor: int, events: int) -> None:
        if descriptor in self._by_descriptor:
            self._poller.modify(descriptor, events)
        else:
            self._by_descriptor[descriptor] = peer
            self._poller.register(descriptor, events)

    def forget(self, descriptor: int) -> None:
        del self._by_descriptor[descriptor]
        self._poller.unregister(descriptor)

    def later(self, call: Callable[[], None]) -> None:
        """Call a function when all have been read, before answers are sent."""
        self._calls.append(call)

    def send_soon(self, peer: Peer) -> None:
        if not self._sending and not self._in_turn:
            self.loop.call_soon(self._send)
        self._sending.append(peer)

    def catch_up_soon(self, peer: Peer) -> None:
        """Make a peer act in its turn, although nothing more was received."""
        self._behind.append(peer)
        if not self._in_turn:
            self._call_turn()

    def end_after_turn(self, error: BaseException) -> None:
        """End the program for a hook, after all requests read in this turn are answered."""
        self._ending = self._ending or error

    def _call_turn(self) -> None:
        if self._next_turn is None:
            self._next_turn = self.loop.call_soon(self._turn)

    def _turn(self) -> None:
        if self._next_turn is not None:
            self._next_turn.cancel()
            self._next_turn = None
        self._in_turn = True
        self.now = self.loop.time()
        for descriptor, events in self._poller.poll(0, TURN_EVENTS):
            # The turn of another connection may have closed this one.
            if peer := self._by_descriptor.get(descriptor):
                peer.act(events)
        self._finish_turn()
        if self._behind:
            self._catch_up()
        self._in_turn = False
        if self._ending is not None:
            error, self._ending = self._ending, None
            self.end()
            raise error

    def _catch_up(self) -> None:
        for _ in range(min(TURN_EVENTS, len(self._behind))):
            self._behind.popleft().catch_up()
        self._finish_turn()
        if self._behind:
            self._call_turn()

    def _finish_turn(self) -> None:
        calls, self._calls = self._calls, []
        for call in calls:
            try:
                call()
            except ENDS as error:
                self.end_after_turn(error)
            except BaseException:  # a mistake of ours must not end all turns
                logger.exception("requests are lost")
        self._send()

    def _send(self) -> None:
        sending, self._sending = self._sending, []
        for peer in sending:
            peer.send()

    # --- deadlines -----------------------------------------------------------------------

    def set_deadline(self, peer: Peer) -> None:
        """Set the deadline of a peer, unless it has one already."""
        self.deadlines.setdefault(peer, self.loop.time() + self.limits.frame_timeout)

    def drop_deadline(self, peer: Peer) -> None:
        self.deadlines.pop(peer, None)


class Peer:
    """One client. It is read only while it takes its answers and is not throttled."""

    __slots__ = (
        "_descriptor", "_is_behind", "_is_closing", "_is_full", "_is_reading", "_is_sending",
        "_is_throttled", "_session", "_socket", "_turns", "_unsent", "address", "has_asked",
        "holder", "idle_since", "role", "trace", "usage",
    )  # fmt: skip

    def __init__(
        self,
        turns: Turns,
        client: socket.socket,
        address: str,
        usage: Address[Peer],
        make: MakePeerSession,
    ) -> None:
        self.address: str = address
        self.trace: Trace | None = None
        # A session within TLS has its own.
        self.role: str | None = None
        self.holder: CertificateHolder | None = None
        self.usage: Address[Peer] = usage  # shared with all other connections of its host
        self.has_asked: bool = False
        self.idle_since: float = turns.loop.time()  # of its last request, or since it came
        self._turns = turns
        self._socket = client
        self._descriptor = client.fileno()
        # Usually one answer, as bytes, which is not copied; a bytearray if the client reads slowly.
        self._unsent: bytes | bytearray = b""
        self._is_sending = self._is_full = self._is_throttled = self._is_closing = False
        self._is_reading = True
        self._is_behind = False  # True while it waits for its turn to catch up
        self._session = make(self)
        turns.watch(self, self._descriptor, POLLIN)

    def close(self) -> None:
        if self._descriptor < 0:
            return
        self._session.close()
        del self._session  # a reference cycle, which only the garbage collector would find
        self._turns.forget(self._descriptor)
        self._descriptor = -1
        with contextlib.suppress(OSError):
            self._socket.send(self._unsent)  # its last bytes, if the client takes them
            # Unread bytes would make this a reset, which takes sent answers from the client.
            self._socket.recv(1 << 16)
        self._socket.close()
        self._turns.remove(self)

    def abandon(self) -> None:
        self._descriptor = -1
        self._socket.close()

    def act(self, events: int) -> None:
        """Handle events; without events, do work that was left for later."""
        try:
            if events & POLLIN:
                self._take()
            elif events & (POLLHUP | POLLERR):
                self.close()
            elif not events:
                self._take(b"")
            if events & POLLOUT:
                self.send()
        except ENDS as error:
            self._turns.end_after_turn(error)
        except BaseException:  # a mistake of ours must not cost the others their turn
            logger.exception("%s: connection closed", self.address)
            self.close()

    def catch_up(self) -> None:
        self._is_behind = False
        if self._descriptor >= 0 and not self._is_held:
            self.act(0)
            self.follow()

    def resume(self) -> None:
        """Read again, because the address may send requests again."""
        self._is_throttled = False
        self.follow()

    def _take(self, data: bytes | None = None) -> int:
        """
        Read bytes, or go on with b""; return the number of requests. Every request passes through
        it.
        """
        if data is None:
            try:
                data = self._socket.recv(READ_BYTES)
            except (BlockingIOError, InterruptedError):
                return 0
            except OSError:
                self.close()
                return 0
            if not data:  # the client sends no more requests, but may still read answers
                self.end()
                return 0
        turns, session = self._turns, self._session
        try:
            requests = session.receive(data)
        except FrameError as error:
            turns.log.warning("%s: connection closed: %s", self.address, error)
            turns.statistics.closed_out_of_step += 1
            self.end()
            return 0
        if self._descriptor < 0:  # a hook closed it
            return requests
        if requests:
            self.has_asked = True
            self.idle_since = turns.now
            turns.drop_deadline(self)
        if self._is_closing or (self._is_reading and session.state is UNFINISHED):
            turns.set_deadline(self)
        elif not requests:
            turns.drop_deadline(self)
        return requests

    # --- answers ------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        if not self._unsent:
            self._turns.send_soon(self)
        self._unsent += data
        if self._is_sending:
            self._pause_if_full()

    def send(self) -> None:
        """Send as much as the client takes, and the rest when it takes more."""
        if self._descriptor < 0:
            return
        try:
            size = self._socket.send(self._unsent)
        except (BlockingIOError, InterruptedError):
            size = 0
        except OSError:
            self.close()
            return
        if size < len(self._unsent):
            self._unsent = bytearray(self._unsent[size:])
            if not self._is_sending:
                self._is_sending = True
                self._watch()
            self._pause_if_full()
        else:
            self._unsent = b""
            if self._is_sending:
                self._is_sending = self._is_full = False
                self._watch()
                self.follow()
        if self._is_closing:
            self._close_if_done()

    def _pause_if_full(self) -> None:
        if len(self._unsent) > self._turns.limits.max_unsent and not self._is_full:
            self._is_full = True
            self._turns.statistics.paused += 1
            self._turns.log.warning(
                "%s: not read until it takes its answers (max_unsent)", self.address
            )
            self.follow()

    def end(self) -> None:
        """Close the connection when all requests are answered, and the answers sent."""
        if self._descriptor < 0:
            return
        self._is_closing = True
        self._session.end()
        self.follow()
        self._turns.set_deadline(self)
        # Requests of this turn are answered by then, unless their answers are delayed.
        self._turns.loop.call_soon(self._close_if_done)

    def hang_up(self) -> bool:
        self.end()
        return True

    def _close_if_done(self) -> None:
        if self._descriptor < 0 or self._unsent:
            return
        if self._session.state is not SessionState.OWING:
            self.close()

    # --- reading and pausing --------------------------------------------------------------

    @property
    def _is_held(self) -> bool:
        return self._is_full or self._is_throttled or self._is_closing

    def follow(self) -> None:
        """Read or pause, depending on the present state."""
        if self._descriptor < 0:
            return
        is_held, state = self._is_held, self._session.state
        if state is SessionState.BEHIND and not (is_held or self._is_behind):
            self._is_behind = True
            self._turns.catch_up_soon(self)
        read = not (is_held or state in UNREAD)
        if read != self._is_reading:
            self._is_reading = read
            self._watch()
            # The timeout of a frame is suspended while its connection is not read.
            if not read:
                self._turns.drop_deadline(self)
            elif state is UNFINISHED:
                self._turns.set_deadline(self)

    def _watch(self) -> None:
        events = POLLIN * self._is_reading | POLLOUT * self._is_sending
        self._turns.watch(self, self._descriptor, events)
