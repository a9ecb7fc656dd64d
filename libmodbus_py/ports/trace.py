"""Every ADU that a client or a server sends and receives, for callbacks and the log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from operator import contains
from typing import TYPE_CHECKING, Literal, NamedTuple

from ..protocol.checks import finished, log_failure
from ..protocol.framing import pdu_of, transaction_of
from .schemes import framing_of

if TYPE_CHECKING:
    from logging import Logger

WIRE = "libmodbus_py.wire"

_wire: Logger | None = None


class TracedFrame(NamedTuple):
    """
    One ADU that was sent or received, or bytes that are not a frame.

    Attributes:
        time: seconds since the epoch (time.time).
        endpoint: the URL of the connection; for a server, that of the listening endpoint.
        direction: "sent" or "received".
        adu: all bytes of the ADU, or the bytes that are not a frame.
        unit: 0..255, the unit of the ADU; None for bytes that are not a frame.
        function: 1..255, the function code of the ADU, with bit 7 set in an exception response;
            None for bytes that are not a frame.
        peer: for a server, the client: "192.0.2.7:51234", the serial port, or the path of a Unix
            socket with the client's user and process; None for clients.
    """

    time: float
    endpoint: str
    direction: Literal["sent", "received"]
    adu: bytes
    unit: int | None
    function: int | None
    peer: str | None = None

    @property
    def pdu(self) -> bytes:
        """The PDU of the ADU: function code and data; empty for bytes that are not a frame."""
        return b"" if self.unit is None else pdu_of(framing_of(self.endpoint), self.adu)

    @property
    def transaction(self) -> int | None:
        """
        The transaction id, 0..65535, of an ADU with an MBAP header (tcp, tls, udp).

        None for other framings, and for bytes that are not a frame.
        """
        if self.unit is None:
            return None
        return transaction_of(framing_of(self.endpoint), self.adu)

    def __str__(self) -> str:
        arrow = ">" if self.direction == "sent" else "<"
        where = self.endpoint if self.peer is None else f"{self.endpoint} {self.peer}"
        what = "" if self.unit is None else f"unit {self.unit}, function {self.function}: "
        return f"{where} {arrow} {what}{self.adu.hex(' ')}"


OnTraced = Callable[[TracedFrame], object]


def is_traced(callback: OnTraced | None) -> bool:
    """Return True if there is a callback, or the logger is at DEBUG."""
    return callback is not None or _is_logged()


class Trace:
    """Passes ADUs to a callback, and to the logger ``libmodbus_py.wire`` at DEBUG."""

    def __init__(
        self,
        endpoint: str,
        callback: OnTraced | None,
        peer: str | None = None,
        later: Callable[[str, Callable[[], object]], object] | None = None,
    ) -> None:
        self._endpoint = endpoint
        self._callback = callback
        self._peer = peer
        self._later = later  # makes a call with a name later; None for at once
        # True if a log handler may want frames: without logging imported, there is none.
        self.is_on: Callable[[], bool] = (
            partial(contains, sys.modules, "logging") if callback is None else lambda: True
        )

    def tell(
        self,
        direction: Literal["sent", "received"],
        adu: bytes,
        unit: int | None = None,
        function: int | None = None,
    ) -> None:
        if self._callback is None and not _is_logged():
            assert _wire is not None
            self.is_on = partial(_wire.isEnabledFor, 10)
            return
        frame = TracedFrame(time.time(), self._endpoint, direction, adu, unit, function, self._peer)
        if self._later is None:
            self._publish(frame)
        else:
            self._later("trace", partial(self._publish, frame))

    def _publish(self, frame: TracedFrame) -> None:
        try:
            if _is_logged() and _wire is not None:
                _wire.debug("%s", frame)
        except Exception:  # of a log handler
            log_failure(__name__, "%s: a handler of the log failed", WIRE)
        if self._callback is not None:
            try:
                finished("trace", self._callback(frame))
            except Exception:
                log_failure(__name__, "trace(%s) failed", frame)


def _is_logged() -> bool:
    # A program that has not imported logging cannot have set it; the import here would take an
    # eighth of the time of importing the whole client.
    global _wire
    if _wire is None and "logging" in sys.modules:
        import logging

        _wire = logging.getLogger(WIRE)
    return _wire is not None and _wire.isEnabledFor(10)  # logging.DEBUG
