"""
One unit on a connection: the operations of modbus-connection's ``ModbusUnit``.
"""

from __future__ import annotations

import functools
import reprlib
from collections.abc import Callable, Coroutine
from typing import Any, Concatenate, ParamSpec, TypeVar

from ....client.asynchronous import AsyncClient
from ....protocol.pdu import ReportServerId, ServerId
from .connection import ClientConnection

__all__ = ["ConnectionUnit"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Operation = Callable[Concatenate["ConnectionUnit", Arguments], Coroutine[Any, Any, Result]]


def in_turn(ask: Operation[Arguments, Result]) -> Operation[Arguments, Result]:
    """Make an operation connect, wait for its turn, and raise errors of modbus-connection."""

    @functools.wraps(ask)
    async def asking(
        self: ConnectionUnit, /, *given: Arguments.args, **named: Arguments.kwargs
    ) -> Result:
        shown = [*map(reprlib.repr, given)]
        shown += [f"{name}={reprlib.repr(value)}" for name, value in named.items()]
        return await self.link.carry_out(
            self.unit_id,
            f"{ask.__name__}({', '.join(shown)})",
            functools.partial(ask, self, *given, **named),
        )

    return asking


class WholeServerId(ReportServerId):
    """A request whose identifier ends before the first byte that can be a run indicator."""

    __slots__ = ()

    def _decode_response(self, pdu: bytes) -> ServerId:
        found, data = super()._decode_response(pdu), pdu[2:]
        ends = (end for end in range(1, len(data)) if data[end] in (0x00, 0xFF))
        return ServerId.split(data, next(ends, len(found.identifier)))


class ConnectionUnit:
    """
    A unit, as defined by ``modbus_connection.ModbusUnit``; any number of tasks may use it, as
    long as the connection is not closed.

    Every operation raises subclasses of ``modbus_connection.ModbusError``, and TypeError and
    ValueError for an invalid argument, before anything is sent.

    Attributes:
        link: the connection.
        unit_id: the unit, 0..255.
    """

    def __init__(self, link: ClientConnection, unit_id: int) -> None:
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
        self.link.set_spacing(self.unit_id, seconds)

    def require_timeout(self, seconds: float | None) -> None:
        """Require a timeout of at least so many seconds; None for no requirement."""
        self.link.require_timeout(self.unit_id, seconds)

    def require_connect_delay(self, seconds: float | None) -> None:
        """Require at least so many seconds between connecting and requests; None for none."""
        self.link.require_connect_delay(self.unit_id, seconds)

    def on_connection_lost(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call a function whenever the connection is lost; return a function that ends this."""
        return self.link.on_connection_lost(callback)

    async def disconnect(self) -> None:
        """Close the connection; the next request connects again."""
        await self.link.disconnect()

    # --- registers and bits ---------------------------------------------------------------------

    @in_turn
    async def read_holding_registers(self, address: int, count: int) -> list[int]:
        """Function 3."""
        return await self._client.read_holding_registers(address, count)

    @in_turn
    async def read_input_registers(self, address: int, count: int) -> list[int]:
        """Function 4."""
        return await self._client.read_input_registers(address, count)

    @in_turn
    async def write_register(self, address: int, value: int) -> None:
        """Function 6."""
        await self._client.write_register(address, value)

    @in_turn
    async def write_registers(self, address: int, values: list[int]) -> None:
        """Function 16."""
        await self._client.write_registers(address, values)

    @in_turn
    async def read_coils(self, address: int, count: int) -> list[bool]:
        """Function 1."""
        return await self._client.read_coils(address, count)

    @in_turn
    async def read_discrete_inputs(self, address: int, count: int) -> list[bool]:
        """Function 2."""
        return await self._client.read_discrete_inputs(address, count)

    @in_turn
    async def write_coil(self, address: int, value: bool) -> None:
        """Function 5."""
        await self._client.write_coil(address, value)

    @in_turn
    async def write_coils(self, address: int, values: list[bool]) -> None:
        """Function 15."""
        await self._client.write_coils(address, values)

    @in_turn
    async def mask_write_register(self, address: int, and_mask: int, or_mask: int) -> None:
        """Function 22."""
        await self._client.mask_write_register(address, and_mask, or_mask)

    @in_turn
    async def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, write_values: list[int]
    ) -> list[int]:
        """Function 23."""
        return await self._client.read_write_registers(
            read_address, read_count, write_address, write_values
        )

    # --- others ---------------------------------------------------------------------------------

    @in_turn
    async def read_exception_status(self) -> int:
        """Function 7."""
        return await self._client.read_exception_status()

    @in_turn
    async def diagnostics(self, sub_function: int, data: int = 0) -> int:
        """Function 8."""
        return await self._client.diagnostics(sub_function, data)

    @in_turn
    async def get_comm_event_counter(self) -> tuple[bool, int]:
        """Function 11: whether the device is ready, and how many events there were."""
        counter = await self._client.read_comm_event_counter()
        return counter.status == 0, counter.event_count

    @in_turn
    async def get_comm_event_log(self) -> bytes:
        """Function 12: the events, newest first."""
        return (await self._client.read_comm_event_log()).events

    @in_turn
    async def report_server_id(self) -> bytes:
        """Function 17: the identifier."""
        return (await self._client.execute(WholeServerId())).identifier

    @in_turn
    async def read_file_record(self, file: int, record: int, length: int) -> list[int]:
        """Function 20."""
        (values,) = await self._client.read_file_records([(file, record, length)])
        return values

    @in_turn
    async def write_file_record(self, file: int, record: int, values: list[int]) -> None:
        """Function 21."""
        await self._client.write_file_records([(file, record, values)])

    @in_turn
    async def read_fifo_queue(self, address: int) -> list[int]:
        """Function 24."""
        return await self._client.read_fifo_queue(address)

    @in_turn
    async def read_device_identification(self) -> dict[int, bytes]:
        """Function 43/14: the basic objects by number."""
        return (await self._client.read_device_identification()).objects
