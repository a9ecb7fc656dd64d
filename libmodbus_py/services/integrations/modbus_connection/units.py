"""One unit on a connection: the operations of modbus-connection's ``ModbusUnit``."""

from __future__ import annotations

import functools
import reprlib
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from ....client.asynchronous import AsyncClient
from ....protocol.pdu import ReportServerId, ServerId

if TYPE_CHECKING:
    from . import ModbusConnection

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Operation = Callable[Concatenate["ConnectionUnit", Arguments], Coroutine[Any, Any, Result]]


def in_turn(ask: Operation[Arguments, Result]) -> Operation[Arguments, Result]:
    """Decorate an operation: connect, wait for its turn, and raise errors of modbus-connection."""

    @functools.wraps(ask)
    async def waiting(
        self: ConnectionUnit, /, *arguments: Arguments.args, **keywords: Arguments.kwargs
    ) -> Result:
        texts = [*map(reprlib.repr, arguments)]
        texts += [f"{name}={reprlib.repr(value)}" for name, value in keywords.items()]
        operation = f"{ask.__name__}({', '.join(texts)})"
        asking = functools.partial(ask, self, *arguments, **keywords)
        return await self.link.carry_out(self.unit_id, operation, asking)

    return waiting


def same_as(method: Callable[..., Coroutine[Any, Any, Any]]) -> Operation[..., Any]:
    """Return the operation that calls a method of the client with the same arguments."""

    @in_turn
    @functools.wraps(method)
    async def ask(self: ConnectionUnit, *arguments: Any, **keywords: Any) -> Any:
        return await method(self._client, *arguments, **keywords)

    return ask


class WholeServerId(ReportServerId):
    """A request for the server id, whose identifier ends before the first possible indicator."""

    __slots__ = ()

    def _decode_response(self, pdu: bytes) -> ServerId:
        data = super()._decode_response(pdu).data
        for end in range(1, len(data)):
            if data[end] in (0x00, 0xFF):
                return ServerId.split(data, end)
        return ServerId(data, None)


class ConnectionUnit:
    """
    A unit, as defined by ``modbus_connection.ModbusUnit``, for any number of tasks. An operation
    raises TypeError or ValueError for an invalid argument, before anything is sent.
    """

    def __init__(self, link: ModbusConnection, unit_id: int) -> None:
        self.link = link
        self.unit_id = unit_id

    @property
    def connected(self) -> bool:
        """True if the connection is established."""
        return bool(self.link.connected)

    @property
    def _client(self) -> AsyncClient:
        return self.link.handle(self.unit_id)

    # --- the connection -----------------------------------------------------------------------

    def set_message_spacing(self, seconds: float) -> None:
        """Set the seconds without traffic before and after requests to this unit."""
        self.link._pacer.set_unit_spacing(self.unit_id, seconds)

    def require_timeout(self, seconds: float | None) -> None:
        """Require a timeout of at least this many seconds; None for no requirement."""
        self.link._require_timeout(self.unit_id, seconds)

    def require_connect_delay(self, seconds: float | None) -> None:
        """Require at least this many seconds between connecting and requests; None for any."""
        self.link._require_connect_delay(self.unit_id, seconds)

    def on_connection_lost(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call a function whenever the connection is lost; return a function that stops this."""
        return self.link.on_connection_lost(callback)

    async def disconnect(self) -> None:
        """Close the connection; the next request connects again."""
        await self.link.disconnect()

    # --- operations ---------------------------------------------------------------------------

    read_coils = same_as(AsyncClient.read_coils)
    read_discrete_inputs = same_as(AsyncClient.read_discrete_inputs)
    read_holding_registers = same_as(AsyncClient.read_holding_registers)
    read_input_registers = same_as(AsyncClient.read_input_registers)
    write_coil = same_as(AsyncClient.write_coil)
    write_coils = same_as(AsyncClient.write_coils)
    write_register = same_as(AsyncClient.write_register)
    write_registers = same_as(AsyncClient.write_registers)
    mask_write_register = same_as(AsyncClient.mask_write_register)
    read_fifo_queue = same_as(AsyncClient.read_fifo_queue)
    read_exception_status = same_as(AsyncClient.read_exception_status)
    diagnostics = same_as(AsyncClient.diagnostics)

    @in_turn
    async def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, write_values: list[int]
    ) -> list[int]:
        """Write registers, then read registers, in one request (function 23)."""
        return await self._client.read_write_registers(
            read_address, read_count, write_address, write_values
        )

    @in_turn
    async def get_comm_event_counter(self) -> tuple[bool, int]:
        """Return True if the device is ready, and the number of events (function 11)."""
        counter = await self._client.read_comm_event_counter()
        return counter.status == 0, counter.event_count

    @in_turn
    async def get_comm_event_log(self) -> bytes:
        """Return the bytes of the last events, newest first (function 12)."""
        return (await self._client.read_comm_event_log()).events

    @in_turn
    async def report_server_id(self) -> bytes:
        """Return the identifier of the server (function 17)."""
        return (await self._client.execute(WholeServerId())).identifier

    @in_turn
    async def read_file_record(self, file: int, record: int, length: int) -> list[int]:
        """Read one record of a file (function 20)."""
        (values,) = await self._client.read_file_records([(file, record, length)])
        return values

    @in_turn
    async def write_file_record(self, file: int, record: int, values: list[int]) -> None:
        """Write one record of a file (function 21)."""
        await self._client.write_file_records([(file, record, values)])

    @in_turn
    async def read_device_identification(self) -> dict[int, bytes]:
        """Return the basic identification objects by number (function 43/14)."""
        return (await self._client.read_device_identification()).objects
