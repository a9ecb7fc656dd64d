"""
The methods of clients that send one request each; and connect.

`packaging/generate_blocking.py` makes those of the blocking client of them.
"""

from __future__ import annotations

from collections.abc import Awaitable, Generator, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import InvalidResponse, ModbusError
from .call import Call
from .handle import Handle
from .keywords import NoOthers, public_methods, unexpected

if TYPE_CHECKING:
    from .asyncio_driver import AsyncioDriver
    from .call import Timeouts

__all__ = ["AsyncFunctions"]

Result = TypeVar("Result")


@public_methods("AsyncClient")
class AsyncFunctions(Handle):
    """One method for each function; addresses are 0-based, 0..65535."""

    _driver: AsyncioDriver

    async def connect(self, **wrong: Unpack[NoOthers]) -> None:
        """
        Connect, unless the client is connected. Requests connect by themselves if necessary.

        Raises:
            ModbusConnectionError: the connection could not be established, with errno; or the
                client is closed.
            RuntimeError: an `AsyncClient` belongs to another event loop.
        """
        if wrong:
            raise unexpected(self.connect, wrong)
        await self._driver.run(Call(self._unit, None, self._timeouts))

    async def execute(
        self,
        request: pdu.Request[Result],
        *,
        timeout: float | None = None,
        retries: int | None = None,
        **wrong: Unpack[NoOthers],
    ) -> Result:
        """
        Send any request object of `libmodbus_py.pdu`, and return its result.

        Args:
            request: the request object.
            timeout: seconds for this request, 0.001..86400; None for the handle's.
            retries: retries of this request, 0..100; None for the handle's.

        Returns:
            The result that the client's method for the same function returns.
        """
        if wrong:
            raise unexpected(self.execute, wrong)
        return await self._ask(request, self._timeouts.but(timeout, retries))

    def _ask(
        self, request: pdu.Request[Result], timeouts: Timeouts | None = None
    ) -> Awaitable[Result]:
        """Send a request and return its result; `timeouts` replace those of the handle."""
        unit = self._unit
        is_broadcast = unit == 0 and self._has_broadcast
        call = Call(unit, request, timeouts or self._timeouts, is_broadcast)
        answer: Awaitable[Result] = self._driver.run(call)
        return answer

    async def read_coils(self, address: int, count: int, **wrong: Unpack[NoOthers]) -> list[bool]:
        """Read 1..2000 coils (function 1, modbus_read_bits)."""
        if wrong:
            raise unexpected(self.read_coils, wrong)
        return await self._ask(pdu.ReadCoils(address, count))

    async def read_discrete_inputs(
        self, address: int, count: int, **wrong: Unpack[NoOthers]
    ) -> list[bool]:
        """Read 1..2000 discrete inputs (function 2, modbus_read_input_bits)."""
        if wrong:
            raise unexpected(self.read_discrete_inputs, wrong)
        return await self._ask(pdu.ReadDiscreteInputs(address, count))

    async def read_holding_registers(
        self, address: int, count: int, **wrong: Unpack[NoOthers]
    ) -> list[int]:
        """Read 1..125 holding registers (function 3, modbus_read_registers)."""
        if wrong:
            raise unexpected(self.read_holding_registers, wrong)
        return await self._ask(pdu.ReadHoldingRegisters(address, count))

    async def read_input_registers(
        self, address: int, count: int, **wrong: Unpack[NoOthers]
    ) -> list[int]:
        """Read 1..125 input registers (function 4, modbus_read_input_registers)."""
        if wrong:
            raise unexpected(self.read_input_registers, wrong)
        return await self._ask(pdu.ReadInputRegisters(address, count))

    async def write_coil(self, address: int, value: bool, **wrong: Unpack[NoOthers]) -> None:
        """Write one coil (function 5, modbus_write_bit)."""
        if wrong:
            raise unexpected(self.write_coil, wrong)
        return await self._ask(pdu.WriteCoil(address, value))

    async def write_register(self, address: int, value: int, **wrong: Unpack[NoOthers]) -> None:
        """Write one holding register, 0..65535 (function 6, modbus_write_register)."""
        if wrong:
            raise unexpected(self.write_register, wrong)
        return await self._ask(pdu.WriteRegister(address, value))

    async def write_coils(
        self, address: int, values: Iterable[bool], **wrong: Unpack[NoOthers]
    ) -> None:
        """Write 1..1968 coils (function 15, modbus_write_bits)."""
        if wrong:
            raise unexpected(self.write_coils, wrong)
        return await self._ask(pdu.WriteCoils(address, values))  # type: ignore[arg-type]

    async def write_registers(
        self, address: int, values: Iterable[int], **wrong: Unpack[NoOthers]
    ) -> None:
        """Write 1..123 holding registers, each 0..65535 (function 16, modbus_write_registers)."""
        if wrong:
            raise unexpected(self.write_registers, wrong)
        return await self._ask(pdu.WriteRegisters(address, values))  # type: ignore[arg-type]

    async def mask_write_register(
        self, address: int, and_mask: int, or_mask: int, **wrong: Unpack[NoOthers]
    ) -> None:
        """
        Set a holding register to (current AND and_mask) OR (or_mask AND NOT and_mask).

        Function 22, modbus_mask_write_register; both masks are 0..65535.
        """
        if wrong:
            raise unexpected(self.mask_write_register, wrong)
        return await self._ask(pdu.MaskWriteRegister(address, and_mask, or_mask))

    async def read_write_registers(
        self,
        read_address: int,
        read_count: int,
        write_address: int,
        values: Iterable[int],
        **wrong: Unpack[NoOthers],
    ) -> list[int]:
        """
        Write 1..121 holding registers, then read 1..125.

        Function 23, modbus_write_and_read_registers.
        """
        if wrong:
            raise unexpected(self.read_write_registers, wrong)
        request = pdu.ReadWriteRegisters(read_address, read_count, write_address, values)  # type: ignore[arg-type]
        return await self._ask(request)

    async def read_exception_status(self, **wrong: Unpack[NoOthers]) -> int:
        """Read the eight exception status outputs, lowest in bit 0 (function 7)."""
        if wrong:
            raise unexpected(self.read_exception_status, wrong)
        return await self._ask(pdu.ReadExceptionStatus())

    async def diagnostics(self, sub_function: int, data: int = 0, **wrong: Unpack[NoOthers]) -> int:
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
        if wrong:
            raise unexpected(self.diagnostics, wrong)
        word = integer("data", data, 0, 0xFFFF).to_bytes(2, "big")
        answer = await self._ask(pdu.Diagnostics(sub_function, word))
        return data if answer is None else int.from_bytes(answer, "big")

    async def read_comm_event_counter(self, **wrong: Unpack[NoOthers]) -> pdu.CommEventCounter:
        """Read the status word and the event counter (function 11)."""
        if wrong:
            raise unexpected(self.read_comm_event_counter, wrong)
        return await self._ask(pdu.ReadCommEventCounter())

    async def read_comm_event_log(self, **wrong: Unpack[NoOthers]) -> pdu.CommEventLog:
        """Read the counters and up to 64 events, newest first (function 12)."""
        if wrong:
            raise unexpected(self.read_comm_event_log, wrong)
        return await self._ask(pdu.ReadCommEventLog())

    async def report_server_id(self, **wrong: Unpack[NoOthers]) -> pdu.ServerId:
        """
        Read the identifier and the run status of the device (function 17, modbus_report_slave_id).

        Returns:
            The response, split after an identifier of one byte; use
            ``pdu.ServerId.split(result.data, length)`` for a device whose identifier is longer.
        """
        if wrong:
            raise unexpected(self.report_server_id, wrong)
        return await self._ask(pdu.ReportServerId())

    async def read_file_records(
        self, records: Sequence[tuple[int, int, int]], **wrong: Unpack[NoOthers]
    ) -> list[list[int]]:
        """
        Read records of files (function 20, which libmodbus lacks).

        Args:
            records: 1..35 tuples (file 1..65535, first record 0..9999, number of records
                1..124). All records together must fit into one response.

        Returns:
            For each tuple the list of its records, 0..65535 each.
        """
        if wrong:
            raise unexpected(self.read_file_records, wrong)
        return await self._ask(pdu.ReadFileRecords(records))  # type: ignore[arg-type]

    async def write_file_records(
        self, records: Sequence[tuple[int, int, Iterable[int]]], **wrong: Unpack[NoOthers]
    ) -> None:
        """
        Write records of files (function 21, which libmodbus lacks).

        Args:
            records: tuples (file 1..65535, first record 0..9999, values), with 1..122 values of
                0..65535 each. All of them must fit into one request.
        """
        if wrong:
            raise unexpected(self.write_file_records, wrong)
        return await self._ask(pdu.WriteFileRecords(records))  # type: ignore[arg-type]

    async def read_fifo_queue(self, address: int, **wrong: Unpack[NoOthers]) -> list[int]:
        """Read the 0..31 registers of a FIFO queue without removing them (function 24)."""
        if wrong:
            raise unexpected(self.read_fifo_queue, wrong)
        return await self._ask(pdu.ReadFifoQueue(address))

    async def read_device_identification(
        self, level: str | int = "basic", **wrong: Unpack[NoOthers]
    ) -> pdu.DeviceIdentification:
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
        if wrong:
            raise unexpected(self.read_device_identification, wrong)
        from ..protocol.pdu.interface import identify

        return await self._carry_out(identify(level))

    async def encapsulated_transport(
        self, mei_type: int, data: bytes, **wrong: Unpack[NoOthers]
    ) -> bytes:
        """
        Send up to 251 bytes to an encapsulated interface (function 43).

        Args:
            mei_type: 0..255; 13 is CANopen.
            data: the bytes after the MEI type; they are sent unchanged.

        Returns:
            The bytes after the MEI type of the response.
        """
        if wrong:
            raise unexpected(self.encapsulated_transport, wrong)
        return await self._ask(pdu.EncapsulatedTransport(mei_type, data))

    async def _carry_out(self, steps: Generator[pdu.Request[Any], Any, Result]) -> Result:
        """Send the requests that a generator yields; each result is sent, or its error raised."""
        try:
            request = next(steps)
            while True:
                try:
                    result = await self._ask(request)
                except ModbusError as error:
                    request = steps.throw(error)
                else:
                    request = steps.send(result)
        except StopIteration as done:
            return done.value  # type: ignore[no-any-return]
        except InvalidResponse as error:
            error.unit, error.endpoint = self.unit, self.url
            raise error from None
