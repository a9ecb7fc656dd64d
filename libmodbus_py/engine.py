"""
modbus_reply in memory: requests answered from a mapping, without a network.
"""

from __future__ import annotations

import os
import socket
import threading

from ._c import check, ffi, lib, make
from .mapping import Mapping

__all__ = ["Engine", "engine"]


class Engine:
    """
    modbus_reply on a socketpair.

    libmodbus 3.1.6 sends and receives on it like on any socket; both ends are
    non-blocking, for it would wait for ever on a full one.
    """

    header = bytes(6) + b"\x01"  # MBAP: whatever stands there comes back

    def __init__(self) -> None:
        self._open()

    def close(self) -> None:
        self._inner.close()
        self._outer.close()

    __del__ = close

    def _open(self) -> None:
        self._inner, self._outer = socket.socketpair()
        self._inner.setblocking(False)
        self._outer.setblocking(False)
        self._context = make(lib.modbus_new_tcp(b"127.0.0.1", 0))
        check(lib.modbus_set_socket(self._context, self._inner.fileno()))
        # It sleeps that long after what it finds illegal; 0 is refused.
        check(lib.modbus_set_response_timeout(self._context, 0, 1))
        self._interrupted = False

    def reply(self, pdu: bytes, mapping: Mapping) -> bytes:
        """Answer a request that `decode_request` found good. Hold the mapping's lock."""
        if self._interrupted:  # an answer may still lie in the pair
            self.close()
            self._open()
        self._interrupted = True
        # A zeroed buffer of full size: modbus_reply reads before it checks.
        request = ffi.new("uint8_t[]", lib.MODBUS_TCP_MAX_ADU_LENGTH)
        size = len(self.header) + len(pdu)
        ffi.memmove(request, self.header + pdu, size)
        check(lib.modbus_reply(self._context, request, size, mapping._struct))
        response: bytes = self._outer.recv(lib.MODBUS_TCP_MAX_ADU_LENGTH)
        self._interrupted = False
        return response[len(self.header) :]


_local = threading.local()


def engine() -> Engine:
    """One for each thread."""
    try:
        made: Engine = _local.engine
    except AttributeError:
        made = _local.engine = Engine()
    return made


def _renew_engines() -> None:
    """A child must not answer through the socketpair of its parent."""
    global _local
    _local = threading.local()


os.register_at_fork(after_in_child=_renew_engines)
