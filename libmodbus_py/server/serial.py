"""A serial port of a server."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..ports.endpoint import Endpoint
from ..ports.port import REOPEN_AFTER, Outage, abandoned_in_children
from ..ports.serial import SerialPort
from ..ports.trace import Trace
from ..protocol.errors import ModbusConnectionError
from ..protocol.logs import HarmlessLogger
from .framed import FrameServer
from .limits import ServerStatistics
from .service import ENDS, Service, SessionState

if TYPE_CHECKING:
    from ..security.certificates import CertificateHolder

logger: HarmlessLogger = HarmlessLogger(__name__)


class SerialServer:
    """
    Answers on one port, which is opened again when it was unplugged and comes back. Its session
    sends the answers through it.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        service: Service,
        statistics: ServerStatistics,
        end: Callable[[], None] | None = None,
    ) -> None:
        self._port = SerialPort(endpoint.path, **endpoint.serial_settings)
        self._endpoint = endpoint
        self._make_session = service.sessions(endpoint, statistics)
        self.address: str = endpoint.address
        self.role: str | None = None
        self.holder: CertificateHolder | None = None
        self.trace: Trace | None = None
        self._end = end or self.close
        self._loop = asyncio.get_running_loop()
        self._outage = Outage(logger, endpoint)
        self._retry: asyncio.TimerHandle | None = None
        self._unsent: deque[bytes] = deque()
        self._timer: asyncio.Handle | None = None
        abandoned_in_children(self)

    async def open(self) -> Endpoint:
        self._open()
        return self._endpoint

    def close(self) -> None:
        if self._retry is not None:
            self._retry.cancel()
        self._close()

    def abandon(self) -> None:
        self._port.abandon()

    def _open(self) -> None:
        self._port.open()
        self._session = self._make_session(self)
        self._loop.add_reader(self._port.descriptor, self._read)

    def _close(self) -> None:
        if self._port.descriptor >= 0:
            self._session.close()
            self._loop.remove_reader(self._port.descriptor)
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            self._unsent.clear()
            self._port.close()

    def _read(self) -> None:
        try:
            for data in self._port.receive():
                self._port.silence.heard(self._loop.time())
                self._receive(data)
        except ModbusConnectionError as error:
            self._lose(error)

    def _lose(self, error: ModbusConnectionError) -> None:
        self._outage.begin(error)
        self._close()
        self._retry = self._loop.call_later(REOPEN_AFTER, self._reopen)

    def _receive(self, data: bytes = b"") -> None:
        try:
            self._session.receive(data)
        except ENDS:
            self._end()
            raise

    def follow(self) -> None:
        """Note that silence has completed a frame, or that a fault delays an answer."""
        if self._session.state is SessionState.BEHIND:
            self._receive()

    def hang_up(self) -> bool:
        return False

    def _reopen(self) -> None:
        if not self._outage.try_to_end(self._open):
            self._retry = self._loop.call_later(REOPEN_AFTER, self._reopen)

    def write(self, data: bytes) -> None:
        """Send an answer after the silence that ends the request (serial line, 2.5.1.1)."""
        self._unsent.append(data)
        # As much as a driver keeps may wait; no client waits any more for the oldest answers.
        while sum(map(len, self._unsent)) > 4096:
            self._unsent.popleft()
        if self._timer is None:
            self._send_after_silence()

    def _send_after_silence(self) -> None:
        wait = self._port.silence.over_at - self._loop.time()
        if wait > 0:
            self._timer = self._loop.call_later(wait, self._send_unsent)
        else:
            self._send_unsent()

    def _send_unsent(self) -> None:
        """Send the first answer that waits; without a silence the next would run into it."""
        data = self._unsent.popleft()
        now = self._loop.time()
        try:
            self._port.send([data], now)
        except ModbusConnectionError as error:
            # Later, because a session may be in the midst of its requests.
            self._timer = self._loop.call_soon(self._lose, error)
            return
        silence = self._port.silence
        silence.sent(len(data), now)
        if isinstance(self._session, FrameServer):
            self._session.sent(data, silence.over_at - silence.seconds)
        self._follow_port()

    def _go_on(self) -> None:
        try:
            self._port.go_on(self._loop.time())
        except ModbusConnectionError as error:
            self._lose(error)
        else:
            self._follow_port()

    def _follow_port(self) -> None:
        """Continue after the port's pause; others are served while the line is turned round."""
        self._timer = None
        if self._port.resume_at is not None:
            pause = self._port.resume_at - self._loop.time()
            self._timer = self._loop.call_later(pause, self._go_on)
        elif self._unsent:
            self._send_after_silence()
