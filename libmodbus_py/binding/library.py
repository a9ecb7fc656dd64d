"""
The only import of the compiled module, and the only reading of its errno; modbus_reply in memory:
requests answered from a mapping, without a network.
"""

from __future__ import annotations

import errno
import socket
import struct
import threading
from collections.abc import Iterable, Sequence
from collections.abc import Mapping as MappingABC
from typing import Any

from ..protocol import errors
from ..protocol.scan import NOT_BUILT
from ..system import call_in_children

try:
    from ._libmodbus import ffi, lib
except ImportError as error:
    if "libmodbus.so" in str(error):
        raise ImportError(
            f"libmodbus_py needs the C library libmodbus: apt install libmodbus5 ({error})"
        ) from error
    raise ImportError(f"{NOT_BUILT} ({error})") from error

__all__ = ["ffi", "lib"]  # all other modules import these names from here


_LIBRARY_ERRORS: dict[int, type[errors.ModbusError]] = {
    lib.EMBBADCRC: errors.FrameError,
    lib.EMBBADDATA: errors.InvalidResponse,
    lib.EMBBADEXC: errors.InvalidResponse,
    lib.EMBUNKEXC: errors.InvalidResponse,
    lib.EMBMDATA: errors.InvalidResponse,
    lib.EMBBADSLAVE: errors.InvalidResponse,
    errno.ETIMEDOUT: errors.ModbusTimeoutError,
}


def check(result: int) -> int:
    """
    Return the result of a C call, or raise the error for -1.

    cffi keeps errno per thread, as it was right after the call. It is set to 0 here, because
    libmodbus never clears it, and some of its failures do not set it.

    Raises:
        ModbusError: the call failed; the subclass for its errno, else a ModbusConnectionError.
    """
    if result != -1:
        return result
    number, ffi.errno = ffi.errno, 0
    if lib.MODBUS_ENOBASE <= number <= lib.EMBXGTAR:
        raise errors.ExceptionResponse.of(number - lib.MODBUS_ENOBASE)
    text = ffi.string(lib.modbus_strerror(number)).decode() if number else "libmodbus gave no error"
    kind = _LIBRARY_ERRORS.get(number)
    if kind is not None:
        raise kind(text)
    raise errors.ModbusConnectionError(text, errno=number) from OSError(number, text)


def make(context: Any) -> Any:
    """
    Return a new modbus_t, which is freed when it is no longer referenced.

    Raises:
        ModbusError: it is NULL; as for `check`.
    """
    if context == ffi.NULL:
        check(-1)
    return ffi.gc(context, lib.modbus_free)


def loaded_version() -> tuple[int, int, int]:
    """Return the version of the loaded libmodbus, which need not be that of its header."""
    return (
        lib.libmodbus_version_major,
        lib.libmodbus_version_minor,
        lib.libmodbus_version_micro,
    )


# --- modbus_reply in memory -----------------------------------------------------------------

TABLE_NUMBERS: dict[str, int] = {
    "coils": lib.COILS,
    "discrete_inputs": lib.DISCRETE_INPUTS,
    "holding_registers": lib.HOLDING_REGISTERS,
    "input_registers": lib.INPUT_REGISTERS,
}
"""The names of the C struct members of a table."""


def runs(ranges: Sequence[range]) -> Any:
    """Return the edges of a runs_t, which the caller keeps alive; ranges in order, none empty."""
    return ffi.new("uint16_t[]", [edge for run in ranges for edge in (run[0], run[-1])])


_HEADER = struct.Struct(">HHHB")

_NOWHERE: dict[str, Sequence[range]] = {}

# The outcome of a chunk, as `Device.answer_chunk` returns it. A plain tuple: a class would take as
# long as the rest of Python here.
Answered = tuple[int, bytes, int, int]


def make_tally() -> Any:
    """Return a tally_t: the counts of the replier about the requests of one device."""
    return ffi.new("tally_t *")


class WatchedRequests:
    """The requests that the replier leaves to Python: other functions, and watched ranges."""

    def __init__(
        self,
        functions: Iterable[int] = range(32),
        reads: MappingABC[str, Sequence[range]] = _NOWHERE,
        writes: MappingABC[str, Sequence[range]] = _NOWHERE,
    ) -> None:
        self.struct: Any = ffi.new("watched_t *")
        self.struct.functions = sum(1 << function for function in set(functions))
        self._edges = []  # kept alive
        for places, ranges in ((self.struct.reads, reads), (self.struct.writes, writes)):
            for table, number in TABLE_NUMBERS.items():
                addresses = ranges.get(table, ())
                self._edges.append(runs(addresses))
                places[number] = (len(addresses), self._edges[-1])


class Replier:
    """modbus_reply on a socketpair (answer_chunk.c): `struct` is the replier_t."""

    _pair: tuple[socket.socket, ...] = ()

    def __init__(self) -> None:
        # The answers to one chunk; requests without room are answered in a further call.
        self._answers = ffi.new("uint8_t[]", 1 << 16)
        self.answers: Any = ffi.cast("char *", self._answers)  # which unpack to bytes
        # For a request that may be answered without being counted.
        self.unused_tally: Any = make_tally()
        self.all: WatchedRequests = WatchedRequests()
        self._open()

    def close(self) -> None:
        for end in self._pair:
            end.close()

    def __del__(self) -> None:
        self.close()

    def renew(self) -> None:
        """Replace the socketpair, in which answers may remain."""
        self.close()
        self._open()

    def _open(self) -> None:
        self._pair = inner, outer = socket.socketpair()
        # libmodbus would wait for ever on a full one.
        inner.setblocking(False)
        outer.setblocking(False)
        self._context = make(lib.modbus_new_tcp(b"127.0.0.1", 0))
        check(lib.modbus_set_socket(self._context, inner.fileno()))
        # libmodbus sleeps for this time after an illegal request; 0 is refused.
        check(lib.modbus_set_response_timeout(self._context, 0, 1))
        self.struct: Any = ffi.new("replier_t *")
        self.struct.context = self._context
        self.struct.outlet = outer.fileno()
        self.struct.answers = self._answers
        self.struct.room = len(self._answers)


_local = threading.local()


def replier() -> Replier:
    """Return the replier of this thread."""
    try:
        own: Replier = _local.replier
    except AttributeError:
        own = _local.replier = Replier()
    return own


def answer_in_c(
    own: Replier,
    mapping: Any,
    places: WatchedRequests,
    tally: Any,
    unit: int,
    data: bytes,
    start: int,
) -> Answered:
    """Answer the requests from ``data[start]`` on (`Device.answer_chunk`). Hold the lock."""
    struct = own.struct
    end = lib.answer_chunk(struct, mapping, places.struct, tally, unit, data, start, len(data))
    if end == -1:
        own.renew()
        check(end)
    return end, ffi.unpack(own.answers, struct.size), struct.requests, struct.refused


def reply(pdu: bytes, mapping: Any) -> bytes:
    """Answer one request that `decode_request` found good. Hold the mapping's lock."""
    own = replier()
    data = _HEADER.pack(0, 0, 1 + len(pdu), 1) + pdu
    return answer_in_c(own, mapping, own.all, own.unused_tally, 1, data, 0)[1][_HEADER.size :]


def _renew_repliers() -> None:
    """Make new repliers in a forked child, which must not use the socketpair of its parent."""
    global _local
    _local = threading.local()


call_in_children(_renew_repliers)
