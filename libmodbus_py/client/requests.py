"""
The methods of both clients that send one request each, and how methods of both are made, once.

A method makes a request (`asks`), or is a procedure that yields requests, one or `Several`, and is
sent results (`follows`). A blocking client carries it out at once; an awaiting one returns a
coroutine.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Coroutine, Generator, Iterable, Sequence
from functools import update_wrapper
from typing import (
    TYPE_CHECKING,
    Any,
    Concatenate,
    Generic,
    NamedTuple,
    ParamSpec,
    Protocol,
    TypeAlias,
    TypeVar,
    Unpack,
    overload,
)

from ..protocol import pdu
from ..protocol.checks import integer

if TYPE_CHECKING:
    from ..protocol.tables import RegisterTable as Table
    from ..protocol.words import BitsType, FloatType, IntegerType, Layout, TextType, TypeName

# fmt: off
__all__ = [
    "CONNECT", "LOCK", "Awaiting", "Blocking", "Later", "Requests", "Several", "Step", "Steps",
    "follows", "one_by_type", "several_by_type",
]
# fmt: on

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Several(NamedTuple):
    """
    Requests that a procedure makes together, as `execute_many` takes them.

    With `stops`, nothing is sent after a ModbusError, which is returned among the results.
    """

    requests: Iterable[pdu.Request[Any]]
    max_in_flight: int
    return_exceptions: bool
    stops: bool = False


class Step(enum.Enum):
    """The steps of procedures that are no requests."""

    CONNECT = enum.auto()
    LOCK = enum.auto()  # to change registers: others that do so wait for the procedure's end


CONNECT, LOCK = Step.CONNECT, Step.LOCK

Later: TypeAlias = Coroutine[Any, Any, Result]
Steps: TypeAlias = Generator[pdu.Request[Any] | Several | Step, Any, Result]


class Blocking:
    """A client whose methods return results."""

    _follow: Callable[..., Any]

    def _refuse(self, error: Exception) -> Any:
        raise error


class Awaiting:
    """A client whose methods return coroutines."""

    _follow: Callable[..., Any]

    async def _refuse(self, error: Exception) -> Any:
        raise error


if TYPE_CHECKING:
    Now = TypeVar("Now", covariant=True)
    Then = TypeVar("Then", covariant=True)

    class OfBoth(Generic[Now, Then]):
        """A method of both clients, with its type on a blocking client and on the other."""

        @overload
        def __get__(self, client: Blocking, owner: object) -> Now: ...
        @overload
        def __get__(self, client: Awaiting, owner: object) -> Then: ...
        @overload
        def __get__(self, client: None, owner: object) -> Any: ...
        def __get__(self, client: Any, owner: object) -> Any: ...

    def asks(
        make: Callable[Concatenate[Any, Arguments], pdu.Request[Result]],
    ) -> OfBoth[Callable[Arguments, Result], Callable[Arguments, Later[Result]]]: ...

    def follows(
        make: Callable[Concatenate[Any, Arguments], Steps[Result]],
    ) -> OfBoth[Callable[Arguments, Result], Callable[Arguments, Later[Result]]]: ...

    # The types of values by the names of their types: read_value(..., "float32") is a float on a
    # blocking client, and one to await on the other.
    Integer = TypeVar("Integer", covariant=True)
    Real = TypeVar("Real", covariant=True)
    Bits = TypeVar("Bits", covariant=True)
    Text = TypeVar("Text", covariant=True)
    Unknown = TypeVar("Unknown", covariant=True)

    class ReadOne(Protocol[Integer, Real, Bits, Text, Unknown]):
        """A method that reads one value, with its result for each kind of type."""

        @overload
        def __call__(
            self, table: Table, address: int, type: IntegerType, **_: Unpack[Layout]
        ) -> Integer: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: FloatType, **_: Unpack[Layout]
        ) -> Real: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: BitsType, **_: Unpack[Layout]
        ) -> Bits: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: TextType, **_: Unpack[Layout]
        ) -> Text: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: TypeName, **_: Unpack[Layout]
        ) -> Unknown: ...

    class ReadSeveral(Protocol[Integer, Real, Bits, Text, Unknown]):
        """A method that reads some values, with its result for each kind of type."""

        @overload
        def __call__(
            self, table: Table, address: int, type: IntegerType, count: int = 1, **_: Unpack[Layout]
        ) -> Integer: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: FloatType, count: int = 1, **_: Unpack[Layout]
        ) -> Real: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: BitsType, count: int = 1, **_: Unpack[Layout]
        ) -> Bits: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: TextType, count: int = 1, **_: Unpack[Layout]
        ) -> Text: ...
        @overload
        def __call__(
            self, table: Table, address: int, type: TypeName, count: int = 1, **_: Unpack[Layout]
        ) -> Unknown: ...

    def one_by_type(
        method: object,
    ) -> OfBoth[
        ReadOne[int, float, list[bool], str, Any],
        ReadOne[Later[int], Later[float], Later[list[bool]], Later[str], Later[Any]],
    ]: ...

    def several_by_type(
        method: object,
    ) -> OfBoth[
        ReadSeveral[list[int], list[float], list[list[bool]], list[str], list[Any]],
        ReadSeveral[
            Later[list[int]],
            Later[list[float]],
            Later[list[list[bool]]],
            Later[list[str]],
            Later[list[Any]],
        ],
    ]: ...

else:
    # Plain functions, so that help() and inspect.signature() work.

    def asks(make):
        def method(self, /, *arguments, **named):
            try:
                request = make(self, *arguments, **named)
            except (TypeError, ValueError) as error:
                return self._refuse(error)
            return self.execute(request)

        return _dressed(method, make)

    def follows(make):
        def method(self, /, *arguments, **named):
            return self._follow(make, arguments, named)

        return _dressed(method, make)

    def _dressed(method, make):
        """As the method is told of: with its result, not with what is made on the way."""
        told = make.__annotations__["return"]
        make.__annotations__["return"] = told.partition("[")[2].removesuffix("]")
        method.__annotations__ = make.__annotations__
        return update_wrapper(method, make)

    def one_by_type(method):
        return method

    several_by_type = one_by_type


class Requests:
    """One method for each function; addresses are 0-based, 0..65535."""

    @asks
    def read_coils(self, address: int, count: int) -> pdu.Request[list[bool]]:
        """Read 1..2000 coils (function 1, modbus_read_bits)."""
        return pdu.ReadCoils(address, count)

    @asks
    def read_discrete_inputs(self, address: int, count: int) -> pdu.Request[list[bool]]:
        """Read 1..2000 discrete inputs (function 2, modbus_read_input_bits)."""
        return pdu.ReadDiscreteInputs(address, count)

    @asks
    def read_holding_registers(self, address: int, count: int) -> pdu.Request[list[int]]:
        """Read 1..125 holding registers (function 3, modbus_read_registers)."""
        return pdu.ReadHoldingRegisters(address, count)

    @asks
    def read_input_registers(self, address: int, count: int) -> pdu.Request[list[int]]:
        """Read 1..125 input registers (function 4, modbus_read_input_registers)."""
        return pdu.ReadInputRegisters(address, count)

    @asks
    def write_coil(self, address: int, value: bool) -> pdu.Request[None]:
        """Write one coil (function 5, modbus_write_bit)."""
        return pdu.WriteCoil(address, value)

    @asks
    def write_register(self, address: int, value: int) -> pdu.Request[None]:
        """Write one holding register, 0..65535 (function 6, modbus_write_register)."""
        return pdu.WriteRegister(address, value)

    @asks
    def write_coils(self, address: int, values: Iterable[bool]) -> pdu.Request[None]:
        """Write 1..1968 coils (function 15, modbus_write_bits)."""
        return pdu.WriteCoils(address, values)  # type: ignore[arg-type]

    @asks
    def write_registers(self, address: int, values: Iterable[int]) -> pdu.Request[None]:
        """Write 1..123 holding registers, each 0..65535 (function 16, modbus_write_registers)."""
        return pdu.WriteRegisters(address, values)  # type: ignore[arg-type]

    @asks
    def mask_write_register(self, address: int, and_mask: int, or_mask: int) -> pdu.Request[None]:
        """
        Set a holding register to (current AND and_mask) OR (or_mask AND NOT and_mask).

        Function 22, modbus_mask_write_register; both masks are 0..65535.
        """
        return pdu.MaskWriteRegister(address, and_mask, or_mask)

    @asks
    def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, values: Iterable[int]
    ) -> pdu.Request[list[int]]:
        """
        Write 1..121 holding registers, then read 1..125.

        Function 23, modbus_write_and_read_registers.
        """
        return pdu.ReadWriteRegisters(read_address, read_count, write_address, values)  # type: ignore[arg-type]

    @asks
    def read_exception_status(self) -> pdu.Request[int]:
        """Read the eight exception status outputs, lowest in bit 0 (function 7)."""
        return pdu.ReadExceptionStatus()

    @follows
    def diagnostics(self, sub_function: int, data: int = 0) -> Steps[int]:
        """
        Run a diagnostic sub-function (function 8).

        Args:
            sub_function: 0..65535; `pdu.SubFunction` names those of the specification.
            data: 0..65535; FF00h makes sub-function 1 (restart) clear the event log, too, and
                sub-function 3 expects the new ASCII delimiter in the high byte.

        Returns:
            The data of the response; `data` itself for sub-function 4 (force listen only), which
            gets no response. `execute(pdu.Diagnostics(0, data))` echoes up to 250 bytes.
        """
        word = integer("data", data, 0, 0xFFFF).to_bytes(2, "big")
        answer = yield pdu.Diagnostics(sub_function, word)
        return data if answer is None else int.from_bytes(answer, "big")

    @asks
    def read_comm_event_counter(self) -> pdu.Request[pdu.CommEventCounter]:
        """Read the status word and the event counter (function 11)."""
        return pdu.ReadCommEventCounter()

    @asks
    def read_comm_event_log(self) -> pdu.Request[pdu.CommEventLog]:
        """Read the counters and up to 64 events, newest first (function 12)."""
        return pdu.ReadCommEventLog()

    @asks
    def report_server_id(self) -> pdu.Request[pdu.ServerId]:
        """
        Read the identifier and the run status of the device (function 17, modbus_report_slave_id).

        Returns:
            The response, split after an identifier of one byte; use
            ``pdu.ServerId.split(result.data, length)`` for a device whose identifier is longer.
        """
        return pdu.ReportServerId()

    @asks
    def read_file_records(
        self, records: Sequence[tuple[int, int, int]]
    ) -> pdu.Request[list[list[int]]]:
        """
        Read records of files (function 20, which libmodbus lacks).

        Args:
            records: 1..35 tuples (file 1..65535, first record 0..9999, number of records
                1..124). All records together must fit into one response.

        Returns:
            For each tuple the list of its records, 0..65535 each.
        """
        return pdu.ReadFileRecords(records)  # type: ignore[arg-type]

    @asks
    def write_file_records(
        self, records: Sequence[tuple[int, int, Iterable[int]]]
    ) -> pdu.Request[None]:
        """
        Write records of files (function 21, which libmodbus lacks).

        Args:
            records: tuples (file 1..65535, first record 0..9999, values), with 1..122 values of
                0..65535 each. All of them must fit into one request.
        """
        return pdu.WriteFileRecords(records)  # type: ignore[arg-type]

    @asks
    def read_fifo_queue(self, address: int) -> pdu.Request[list[int]]:
        """Read the 0..31 registers of a FIFO queue without removing them (function 24)."""
        return pdu.ReadFifoQueue(address)

    @follows
    def read_device_identification(
        self, level: str | int = "basic"
    ) -> Steps[pdu.DeviceIdentification]:
        """
        Read the identification of a device (function 43/14), with as many requests as needed.

        Args:
            level: "basic", "regular" or "extended"; or the id of a single object, 0..255.

        Returns:
            The objects that the device sent; its `complete` is False if some of them are missing.

        Raises:
            InvalidResponse: the device sends the same objects again and again, or fewer than it
                announced, and one of the three mandatory objects is missing.
        """
        from ..protocol.pdu.interface import identify

        return (yield from identify(level))

    @asks
    def encapsulated_transport(self, mei_type: int, data: bytes) -> pdu.Request[bytes]:
        """
        Send up to 251 bytes to an encapsulated interface (function 43).

        Args:
            mei_type: 0..255; 13 is CANopen.
            data: the bytes after the MEI type; they are sent unchanged.

        Returns:
            The bytes after the MEI type of the response.
        """
        return pdu.EncapsulatedTransport(mei_type, data)
