"""
The functions of a device that libmodbus lacks: files, queues, identification and diagnostics.
"""

from __future__ import annotations

import reprlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Mapping as MappingABC
from itertools import compress
from operator import index
from typing import Any, ClassVar, TypeAlias

from ..protocol.checks import checked_callback, integer
from ..protocol.errors import IllegalDataAddress, IllegalDataValue, IllegalFunction
from ..protocol.framing import delimiter_after
from ..protocol.mistakes import WrongType, inside
from ..protocol.pdu import (
    RECORDS_PER_FILE,
    Diagnostics,
    EncapsulatedTransport,
    IdentificationPage,
    ReadCommEventCounter,
    ReadCommEventLog,
    ReadDeviceIdentification,
    ReadExceptionStatus,
    ReadFifoQueue,
    ReadFileRecords,
    ReportServerId,
    Request,
    ServerId,
    SubFunction,
    WriteFileRecords,
)
from ..protocol.pdu.interface import OBJECT_NAMES, ReadDeviceIdCode, pages
from .event_log import EventLog
from .hooks import timed

__all__ = ["DEFAULT_SERVER_ID", "PythonFunctions", "RecordFile"]

DEFAULT_SERVER_ID = ServerId(b"\x01", True, b"libmodbus-py")

DEFAULT_IDENTIFICATION: dict[str | int, str | bytes] = {
    "VendorName": "libmodbus-py",
    "ProductCode": "Device",
    "MajorMinorRevision": "0.1",
}


Records: TypeAlias = int | Iterable[int] | MappingABC[int, int]
"""The number of records, or their values."""


class RecordFile:
    """
    One file: registers with record numbers 0..9999, not all of which need to exist.

    ``file[record]`` reads and writes one record; ``len`` and iteration cover
    the records that exist, in ascending order.

    Args:
        records: the number of records, 0..10000, all 0; or the values, 0..65535, from record 0 on;
            or ``{record: value}``.

    Raises:
        TypeError, ValueError: a record or value is out of range.
        IndexError: a record does not exist.
    """

    def __init__(self, records: Records) -> None:
        if isinstance(records, int) and not isinstance(records, bool):
            records = [0] * integer("records", records, 0, RECORDS_PER_FILE)
        if not isinstance(records, Iterable) or isinstance(records, str):
            expected = "a number of records, a list of values or {record: value}"
            raise WrongType("records", f"must be {expected}, not {reprlib.repr(records)}")
        if not isinstance(records, MappingABC):
            records = dict(enumerate(records))
        numbers = [integer("record", record, 0, RECORDS_PER_FILE - 1) for record in records]
        self._values = array("H", bytes(2 * (max(numbers, default=-1) + 1)))
        self._exists = bytearray(len(self._values))
        for record, value in zip(numbers, records.values(), strict=True):
            self._values[record] = integer("value", value, 0, 0xFFFF)
            self._exists[record] = 1

    def __getitem__(self, record: int) -> int:
        return self._values[self._existing(record)]

    def __setitem__(self, record: int, value: int) -> None:
        self._values[self._existing(record)] = integer("value", value, 0, 0xFFFF)

    def __len__(self) -> int:
        return self._exists.count(1)

    def __iter__(self) -> Iterator[int]:
        return compress(self._values, self._exists)

    @property
    def view(self) -> memoryview:
        """The memory of the records from 0 on, not a copy; records that do not exist are 0."""
        return memoryview(self._values)

    def has(self, record: int, length: int) -> bool:
        """Return True if `length` records, starting at `record`, all exist."""
        return record + length <= len(self._values) and all(self._exists[record : record + length])

    def read(self, record: int, length: int) -> list[int]:
        """Return `length` records, all of which must exist (`has`)."""
        return self._values[record : record + length].tolist()

    def write(self, record: int, values: tuple[int, ...]) -> None:
        """Set records, all of which must exist (`has`)."""
        self._values[record : record + len(values)] = array("H", values)

    def _existing(self, record: int) -> int:
        number = index(record)
        if number < 0 or not self.has(number, 1):
            raise IndexError(f"no record {record}")
        return number


Handlers = MappingABC[type[Request[Any]], Callable[[Any], Any]]
"""Request class -> the function of the application that answers its requests."""


class PythonFunctions:
    """The part of a `Device` that answers the functions which libmodbus lacks."""

    def __init__(
        self,
        files: MappingABC[int, Records] | None,
        fifos: MappingABC[int, Sequence[int]] | None,
        identification: MappingABC[str | int, str | bytes] | None,
        server_id: ServerId,
        exception_status: int,
        canopen: Callable[[bytes], bytes] | None,
        handlers: Handlers | None,
    ) -> None:
        self.files: dict[int, RecordFile] = {}
        for number, records in _items("files", "{file number: records}", files):
            with inside("files", number):
                self.files[integer((), number, 1, 0xFFFF)] = RecordFile(records)
        self.fifos: dict[int, list[int]] = {}
        for address, queue in _items("fifos", "{pointer address: registers}", fifos):
            if not isinstance(queue, Iterable):
                expected = f"must be a list of registers, not {reprlib.repr(queue)}"
                raise WrongType(("fifos", address), expected)
            self.fifos[integer("fifo", address, 0, 0xFFFF)] = list(queue)
        self.server_id = server_id
        self.exception_status: int = integer("exception_status", exception_status, 0, 0xFF)
        self.diagnostic_register: int = 0
        self._identification = _checked_identification(identification or {})
        self._canopen = None if canopen is None else timed("canopen", canopen)
        self._handlers = {**self._own, **_bound(handlers or {})}

    def _file(self, number: int, record: int, length: int) -> RecordFile:
        file = self.files.get(number)
        if file is None or not file.has(record, length):
            raise IllegalDataAddress(f"file {number} lacks records {record}+{length}")
        return file

    def _read_file_records(self, request: ReadFileRecords, _: EventLog) -> list[list[int]]:
        return [
            self._file(number, record, length).read(record, length)
            for number, record, length in request.records
        ]

    def _write_file_records(self, request: WriteFileRecords, _: EventLog) -> None:
        # All are found before the first is written: all or nothing.
        files = [self._file(file, at, len(values)) for file, at, values in request.records]
        for file, (_number, record, values) in zip(files, request.records, strict=True):
            file.write(record, values)

    def _fifo(self, address: int) -> list[int]:
        if address not in self.fifos:
            raise IllegalDataAddress(f"no queue at {address}")
        return self.fifos[address]

    def _read_fifo_queue(self, request: ReadFifoQueue, _: EventLog) -> list[int]:
        queue = list(self._fifo(request.address))
        if len(queue) > request.max_count:
            raise IllegalDataValue(f"{len(queue)} registers in the queue")
        return queue

    def _encapsulated_transport(self, request: EncapsulatedTransport, _: EventLog) -> bytes:
        if self._canopen is None:
            raise IllegalFunction(function=request.function)
        return self._canopen(request.data)

    def _read_device_identification(
        self, request: ReadDeviceIdentification, _: EventLog
    ) -> IdentificationPage:
        objects = self._identification
        highest = max(objects)
        conformity = 0x80 | (1 if highest <= 2 else 2 if highest <= 6 else 3)
        number = request.object_id
        if request.code != ReadDeviceIdCode.INDIVIDUAL:
            return pages(request, objects)._replace(conformity=conformity)
        if number not in objects:
            raise IllegalDataAddress(f"no object {number}")
        return IdentificationPage(conformity, None, {number: objects[number]})

    def _diagnostics(self, request: Diagnostics, log: EventLog) -> bytes:
        data = request.data
        try:
            sub_function = SubFunction(request.sub_function)
        except ValueError:
            raise IllegalFunction(f"no sub-function {request.sub_function}") from None
        silencing = (SubFunction.RESTART_COMMUNICATIONS, SubFunction.FORCE_LISTEN_ONLY)
        if sub_function in silencing and not log.is_serial:
            raise IllegalFunction("one client must not silence the device for all")
        allowed = _DATA.get(sub_function, (b"\0\0",))
        if allowed is not None and data not in allowed:
            raise IllegalDataValue(f"data {data.hex()}")
        match sub_function:
            case SubFunction.RETURN_QUERY_DATA | SubFunction.RESTART_COMMUNICATIONS:
                pass  # a restart comes after its echo
            case SubFunction.CHANGE_ASCII_DELIMITER:
                delimiter = delimiter_after(request.encode(), log.delimiter)
                if delimiter != data[0] or data[1]:
                    raise IllegalDataValue(f"delimiter {data.hex()}")
                log.delimiter = delimiter
            case SubFunction.FORCE_LISTEN_ONLY:
                log.enter_listen_only()
            case SubFunction.CLEAR_COUNTERS:
                log.clear_counters()
                self.diagnostic_register = 0
            case SubFunction.CLEAR_OVERRUN:
                log.clear_overrun()
            case SubFunction.RETURN_DIAGNOSTIC_REGISTER:
                return self.diagnostic_register.to_bytes(2, "big")
            case _:
                return log.counter(sub_function).to_bytes(2, "big")
        return data

    # Request class -> the method that answers it; libmodbus answers all others.
    _own: ClassVar[dict[type[Request[Any]], Callable[..., Any]]] = {
        ReadFileRecords: _read_file_records,
        WriteFileRecords: _write_file_records,
        ReadFifoQueue: _read_fifo_queue,
        ReadExceptionStatus: lambda device, request, log: device.exception_status,
        ReportServerId: lambda device, request, log: device.server_id,
        ReadCommEventCounter: lambda device, request, log: log.read_event_counter(),
        ReadCommEventLog: lambda device, request, log: log.read_event_log(),
        Diagnostics: _diagnostics,
        EncapsulatedTransport: _encapsulated_transport,
        ReadDeviceIdentification: _read_device_identification,
    }


# Sub-function -> the data that it accepts; None for any. All others accept 0000.
_DATA: dict[SubFunction, tuple[bytes, ...] | None] = {
    SubFunction.RETURN_QUERY_DATA: None,
    SubFunction.CHANGE_ASCII_DELIMITER: None,
    SubFunction.RESTART_COMMUNICATIONS: (b"\0\0", b"\xff\0"),
}


def _bound(handlers: Handlers) -> dict[type[Request[Any]], Callable[..., Any]]:
    bound: dict[type[Request[Any]], Callable[..., Any]] = {}
    for request, handle in handlers.items():
        if not (isinstance(request, type) and issubclass(request, Request)):
            raise TypeError(f"handlers must be {{request class: function}}, not {request!r}")
        checked_callback(("handlers", request.__name__), handle)  # a better name than below
        measured = timed(f"the handler of {request.__name__}", handle)
        bound[request] = lambda device, request, log, measured=measured: measured(request)
    return bound


def _items(name: str, expected: str, given: Any) -> Iterable[tuple[Any, Any]]:
    if given is not None and not isinstance(given, MappingABC):
        raise WrongType(name, f"must be {expected}, not {reprlib.repr(given)}")
    return (given or {}).items()


def _checked_identification(given: MappingABC[Any, str | bytes]) -> dict[int, bytes]:
    """Return object id -> value, in ascending order."""
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    objects: dict[int, bytes] = {}
    for key, value in [*DEFAULT_IDENTIFICATION.items(), *given.items()]:
        if isinstance(key, str) and key not in numbers:
            raise ValueError(f"identification: {key!r} must be one of {', '.join(numbers)}")
        number = numbers[key] if isinstance(key, str) else integer("object id", key, 0, 0xFF)
        if 7 <= number < 0x80:
            raise ValueError(f"identification: object ids 7..127 are reserved, such as {number}")
        if not isinstance(value, str | bytes):
            raise TypeError(f"identification[{key!r}] must be text or bytes, not {value!r}")
        data = value.encode("ascii") if isinstance(value, str) else value
        if len(data) > 244:
            raise ValueError(f"identification[{key!r}] takes {len(data)} bytes, more than 244")
        objects[number] = data
    return dict(sorted(objects.items()))
