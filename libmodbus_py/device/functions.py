"""The functions of a device that libmodbus lacks: files, queues, identification and diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from collections.abc import Mapping as MappingABC
from typing import TYPE_CHECKING, Any, ClassVar

from ..protocol import pdu
from ..protocol.checks import checked_callback, integer
from ..protocol.errors import IllegalDataAddress, IllegalDataValue, IllegalFunction
from ..protocol.framing import delimiter_after
from ..protocol.mistakes import WrongType, WrongValue
from ..protocol.pdu.interface import OBJECT_NAMES, ReadDeviceIdCode, pages
from .event_log import EventLog
from .hooks import timed
from .records import FifoQueue, Files, Queues, RecordFile, Records, items_of

DEFAULT_SERVER_ID = pdu.ServerId(b"\x01", True, b"libmodbus-py")

DEFAULT_IDENTIFICATION: dict[str | int, str | bytes] = {
    "VendorName": "libmodbus-py",
    "ProductCode": "Device",
    "MajorMinorRevision": "0.1",
}


Handlers = MappingABC[type[pdu.Request[Any]], Callable[[Any], Any]]
"""Request class -> the function of the application that answers its requests."""


# Attributes that the device would ignore if they were set.
ARGUMENTS_ONLY = frozenset((
    "after_write", "authorize", "before_read", "before_write", "canopen", "handlers",
    "identification",
))  # fmt: skip


class PythonFunctions:
    """The part of a `Device` that answers the functions which libmodbus lacks."""

    def __init__(
        self,
        files: MappingABC[int, Records] | None,
        fifos: MappingABC[int, Sequence[int]] | None,
        identification: MappingABC[str | int, str | bytes] | None,
        server_id: pdu.ServerId,
        exception_status: int,
        canopen: Callable[[bytes], bytes] | None,
        handlers: Handlers | None,
    ) -> None:
        self.files = files
        self.fifos = fifos
        self.server_id = server_id
        self.exception_status = exception_status
        self.diagnostic_register = 0
        self._identification = _checked_identification(identification)
        self._canopen = None if canopen is None else timed("canopen", canopen)
        self._handlers = {**self._own, **_bound(handlers)}

    @property
    def files(self) -> Files:
        """``{file number: RecordFile}``, with all records that clients wrote."""
        return self._files

    @files.setter
    def files(self, files: MappingABC[int, RecordFile | Records] | None) -> None:
        self._files = Files(files)

    @property
    def fifos(self) -> Queues:
        """``{pointer address: FifoQueue}``; the program may change the queues."""
        return self._fifos

    @fifos.setter
    def fifos(self, fifos: MappingABC[int, Iterable[int]] | None) -> None:
        self._fifos = Queues(fifos)

    @property
    def server_id(self) -> pdu.ServerId:
        """The response to function 17."""
        return self._server_id

    @server_id.setter
    def server_id(self, server_id: pdu.ServerId) -> None:
        self._server_id = _checked_server_id(server_id)

    @property
    def exception_status(self) -> int:
        """The response to function 7, 0..255."""
        return self._exception_status

    @exception_status.setter
    def exception_status(self, status: int) -> None:
        self._exception_status = integer("exception_status", status, 0, 0xFF)

    @property
    def diagnostic_register(self) -> int:
        """The response to sub-function 2 of function 8, 0..65535."""
        return self._diagnostic_register

    @diagnostic_register.setter
    def diagnostic_register(self, register: int) -> None:
        self._diagnostic_register = integer("diagnostic_register", register, 0, 0xFFFF)

    if not TYPE_CHECKING:  # to which every attribute would exist then

        def __setattr__(self, name: str, value: object) -> None:
            if name in ARGUMENTS_ONLY:
                raise AttributeError(f"{name} is an argument of Device(...), and cannot be set")
            super().__setattr__(name, value)

    def _file(self, number: int, record: int, length: int) -> RecordFile:
        file = self.files.get(number)
        if file is None or not file.has(record, length):
            raise IllegalDataAddress(f"file {number} lacks records {record}+{length}")
        return file

    def _read_file_records(self, request: pdu.ReadFileRecords, _: EventLog) -> list[list[int]]:
        return [
            self._file(number, record, length).read(record, length)
            for number, record, length in request.records
        ]

    def _write_file_records(self, request: pdu.WriteFileRecords, _: EventLog) -> None:
        # All files are found before the first is written: all or nothing.
        files = [self._file(file, at, len(values)) for file, at, values in request.records]
        for file, (_number, record, values) in zip(files, request.records, strict=True):
            file.write(record, values)

    def _fifo(self, address: int) -> FifoQueue:
        if address not in self.fifos:
            raise IllegalDataAddress(f"no queue at {address}")
        return self.fifos[address]

    def _read_fifo_queue(self, request: pdu.ReadFifoQueue, _: EventLog) -> list[int]:
        queue = list(self._fifo(request.address))
        if len(queue) > request.max_count:
            raise IllegalDataValue(f"{len(queue)} registers in the queue")
        return queue

    def _encapsulated_transport(self, request: pdu.EncapsulatedTransport, _: EventLog) -> bytes:
        if self._canopen is None:
            raise IllegalFunction(function=request.function)
        return self._canopen(request.data)

    def _read_device_identification(
        self, request: pdu.ReadDeviceIdentification, _: EventLog
    ) -> pdu.IdentificationPage:
        objects = self._identification
        highest = max(objects)
        conformity = 0x80 | (1 if highest <= 2 else 2 if highest <= 6 else 3)
        number = request.object_id
        if request.code != ReadDeviceIdCode.INDIVIDUAL:
            return pages(request, objects)._replace(conformity=conformity)
        if number not in objects:
            raise IllegalDataAddress(f"no object {number}")
        return pdu.IdentificationPage(conformity, None, {number: objects[number]})

    def _diagnostics(self, request: pdu.Diagnostics, log: EventLog) -> bytes:
        data = request.data
        try:
            sub_function = pdu.SubFunction(request.sub_function)
        except ValueError:
            raise IllegalFunction(f"no sub-function {request.sub_function}") from None
        silences = (pdu.SubFunction.RESTART_COMMUNICATIONS, pdu.SubFunction.FORCE_LISTEN_ONLY)
        if sub_function in silences and not log.is_serial:
            raise IllegalFunction("one client must not silence the device for all")
        values = _DATA.get(sub_function, (b"\0\0",))
        if values is not None and data not in values:
            raise IllegalDataValue(f"data {data.hex()}")
        match sub_function:
            case pdu.SubFunction.RETURN_QUERY_DATA | pdu.SubFunction.RESTART_COMMUNICATIONS:
                pass  # the restart follows its echo
            case pdu.SubFunction.CHANGE_ASCII_DELIMITER:
                delimiter = delimiter_after(request.encode(), log.delimiter)
                if delimiter != data[0] or data[1]:
                    raise IllegalDataValue(f"delimiter {data.hex()}")
                log.delimiter = delimiter
            case pdu.SubFunction.FORCE_LISTEN_ONLY:
                log.enter_listen_only()
            case pdu.SubFunction.CLEAR_COUNTERS:
                log.clear_counters()
                self.diagnostic_register = 0
            case pdu.SubFunction.CLEAR_OVERRUN:
                log.clear_overrun()
            case pdu.SubFunction.RETURN_DIAGNOSTIC_REGISTER:
                return self.diagnostic_register.to_bytes(2, "big")
            case _:
                return log.counter(sub_function).to_bytes(2, "big")
        return data

    # Request class -> the method that answers it; libmodbus answers all others.
    _own: ClassVar[dict[type[pdu.Request[Any]], Callable[..., Any]]] = {
        pdu.ReadFileRecords: _read_file_records,
        pdu.WriteFileRecords: _write_file_records,
        pdu.ReadFifoQueue: _read_fifo_queue,
        pdu.ReadExceptionStatus: lambda device, request, log: device.exception_status,
        pdu.ReportServerId: lambda device, request, log: device.server_id,
        pdu.ReadCommEventCounter: lambda device, request, log: log.read_event_counter(),
        pdu.ReadCommEventLog: lambda device, request, log: log.read_event_log(),
        pdu.Diagnostics: _diagnostics,
        pdu.EncapsulatedTransport: _encapsulated_transport,
        pdu.ReadDeviceIdentification: _read_device_identification,
    }


# Sub-function -> the data that it accepts; None for any. All others accept 0000.
_DATA: dict[pdu.SubFunction, tuple[bytes, ...] | None] = {
    pdu.SubFunction.RETURN_QUERY_DATA: None,
    pdu.SubFunction.CHANGE_ASCII_DELIMITER: None,
    pdu.SubFunction.RESTART_COMMUNICATIONS: (b"\0\0", b"\xff\0"),
}


def _checked_server_id(server_id: pdu.ServerId) -> pdu.ServerId:
    """Return the response to function 17 if it can be sent."""
    example = 'ServerId(b"\\x01", running=True)'
    if not isinstance(server_id, pdu.ServerId):
        kind = type(server_id).__name__
        raise WrongType("server_id", f"must be a ServerId, such as {example}, not {kind}")
    for name in ("identifier", "additional"):
        if not isinstance(data := getattr(server_id, name), bytes):
            raise WrongType(f"server_id.{name}", f"must be bytes, not {type(data).__name__}")
    if server_id.running not in (True, False, None):
        raise WrongType(
            "server_id.running", f"must be True, False or None, not {server_id.running!r}"
        )
    size = len(server_id.data)
    if not 2 <= size <= pdu.MAX_PDU - 2:
        raise WrongValue("server_id", f"must take 2..{pdu.MAX_PDU - 2} bytes, not {size}")
    return server_id


def _bound(handlers: Handlers | None) -> dict[type[pdu.Request[Any]], Callable[..., Any]]:
    bound: dict[type[pdu.Request[Any]], Callable[..., Any]] = {}
    for request, handle in items_of("handlers", "{request class: function}", handlers):
        if not (isinstance(request, type) and issubclass(request, pdu.Request)):
            raise TypeError(f"handlers must be {{request class: function}}, not {request!r}")
        checked_callback(("handlers", request.__name__), handle)  # a better name than below
        call = timed(f"the handler of {request.__name__}", handle)
        bound[request] = lambda device, request, log, call=call: call(request)
    return bound


def _checked_identification(
    identification: MappingABC[str | int, str | bytes] | None,
) -> dict[int, bytes]:
    """Return object id -> value, in ascending order."""
    numbers = {name: number for number, name in OBJECT_NAMES.items()}
    objects: dict[int, bytes] = {}
    own = items_of("identification", "{object: value}", identification)
    for key, value in [*DEFAULT_IDENTIFICATION.items(), *own]:
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
