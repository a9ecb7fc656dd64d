"""
A device: request PDU in, response PDU out.

The codes libmodbus knows are answered by its modbus_reply, in memory: its context
holds one end of a socketpair and never sees a network, so it serves every
transport alike. Before it stand the exact checks that it lacks.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
from array import array
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Mapping as MappingABC
from operator import index
from typing import Any, ClassVar

from ._c import check, ffi, lib, make
from .arguments import integer
from .errors import ExceptionResponse, IllegalDataAddress, ServerDeviceFailure
from .mapping import Mapping
from .pdu import RECORDS_PER_FILE, ReadFileRecords, Request, WriteFileRecords, decode_request

__all__ = ["Device", "RecordFile"]

logger = logging.getLogger(__name__)


class RecordFile:
    """
    One file: registers with the record numbers 0..9999, holes allowed.

    ``file[record]`` reads and writes one record; ``len`` and iteration go over
    the records that exist, in order.

    Args:
        records: the values 0..65535 from record 0 on, or ``{record: value}``.

    Raises:
        TypeError, ValueError: a record or value that cannot be.
        IndexError: a record that does not exist.
    """

    def __init__(self, records: Iterable[int] | MappingABC[int, int]) -> None:
        if not isinstance(records, MappingABC):
            records = dict(enumerate(records))
        numbers = [integer("record", record, 0, RECORDS_PER_FILE - 1) for record in records]
        self._values = array("H", bytes(2 * (max(numbers, default=-1) + 1)))
        self._holes = set(range(len(self._values))) - set(numbers)
        for record, value in zip(numbers, records.values(), strict=True):
            self._values[record] = integer("value", value, 0, 0xFFFF)

    def __getitem__(self, record: int) -> int:
        return self._values[self._existing(record)]

    def __setitem__(self, record: int, value: int) -> None:
        self._values[self._existing(record)] = integer("value", value, 0, 0xFFFF)

    def __len__(self) -> int:
        return len(self._values) - len(self._holes)

    def __iter__(self) -> Iterator[int]:
        return (value for record, value in enumerate(self._values) if record not in self._holes)

    def has(self, record: int, length: int) -> bool:
        """Say whether all of the `length` records from `record` on exist."""
        wanted = range(record, record + length)
        return wanted.stop <= len(self._values) and self._holes.isdisjoint(wanted)

    def read(self, record: int, length: int) -> list[int]:
        """Give `length` records that exist (`has`)."""
        return self._values[record : record + length].tolist()

    def write(self, record: int, values: tuple[int, ...]) -> None:
        """Set records that exist (`has`)."""
        self._values[record : record + len(values)] = array("H", values)

    def _existing(self, record: int) -> int:
        number = index(record)
        if number < 0 or not self.has(number, 1):
            raise IndexError(f"no record {record}")
        return number


class Device:
    """
    Answers the requests of one unit from a mapping and from files.

    Functions 1-6, 15, 16, 22 and 23 work on the mapping, 20 and 21 on the files;
    others are refused with IllegalFunction. Safe from any thread.

    Args:
        mapping: the four tables.
        files: ``{file number 1..65535: records}``, records as for `RecordFile`.

    Attributes:
        mapping: as given.
        files: ``{file number: RecordFile}``, what clients wrote included.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        mapping: Mapping,
        *,
        files: MappingABC[int, Iterable[int] | MappingABC[int, int]] | None = None,
    ) -> None:
        if not isinstance(mapping, Mapping):
            raise TypeError(f"mapping must be a Mapping, not {type(mapping).__name__}")
        self.mapping = mapping
        self.files: dict[int, RecordFile] = {
            integer("file", number, 1, 0xFFFF): RecordFile(records)
            for number, records in (files or {}).items()
        }
        self._failed: set[int] = set()

    def answer(self, pdu: bytes) -> bytes:
        """
        Execute a request.

        Args:
            pdu: the request, 1..253 bytes.

        Returns:
            The response, an exception response included; nothing for function
            codes 128..255, whose exception has no code.
        """
        function = pdu[0]
        if function & 0x80:
            return b""
        try:
            return self._execute(decode_request(pdu), pdu)
        except ExceptionResponse as refusal:
            if 1 <= refusal.code <= 0xFF:
                return bytes([function | 0x80, refusal.code])
            self._log_failure(function, pdu)
        except Exception:
            self._log_failure(function, pdu)
        return bytes([function | 0x80, ServerDeviceFailure.code])

    def _execute(self, request: Request[Any], pdu: bytes) -> bytes:
        execute = self._own.get(type(request))
        with self.mapping:
            if execute is not None:
                return request.encode_response(execute(self, request))
            return _engine().reply(pdu, self.mapping)

    def _log_failure(self, function: int, pdu: bytes) -> None:
        """Once for each function: a client must not be able to fill the log."""
        if function not in self._failed:
            self._failed.add(function)
            logger.exception("request %s failed; answered with exception 4", pdu.hex(" "))

    def _file(self, number: int, record: int, length: int) -> RecordFile:
        file = self.files.get(number)
        if file is None or not file.has(record, length):
            raise IllegalDataAddress(f"file {number} lacks records {record}+{length}")
        return file

    def _read_file_records(self, request: ReadFileRecords) -> list[list[int]]:
        return [
            self._file(number, record, length).read(record, length)
            for number, record, length in request.records
        ]

    def _write_file_records(self, request: WriteFileRecords) -> None:
        # All pieces are found before the first is written: all or nothing.
        places = [self._file(file, at, len(values)) for file, at, values in request.records]
        for file, (_, record, values) in zip(places, request.records, strict=True):
            file.write(record, values)

    _own: ClassVar[dict[type[Request[Any]], Callable[[Any, Any], Any]]] = {
        ReadFileRecords: _read_file_records,
        WriteFileRecords: _write_file_records,
    }


class _Engine:
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


def _engine() -> _Engine:
    """One for each thread."""
    try:
        engine: _Engine = _local.engine
    except AttributeError:
        engine = _local.engine = _Engine()
    return engine


def _renew_engines() -> None:
    """A child must not answer through the socketpair of its parent."""
    global _local
    _local = threading.local()


os.register_at_fork(after_in_child=_renew_engines)
