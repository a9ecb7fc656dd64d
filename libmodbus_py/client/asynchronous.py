"""
The asyncio client: one method for each function, many requests in flight.

The way of a request: `client` checks it, `channel` gives it a slot and sends it,
`flight` (TCP, UDP) or `alternating` (serial lines) find its answer, over a `connection`
that is opened when wanted, made of a `transport`.
"""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Self, TypeVar

from ..ports.endpoint import Endpoint, parse
from ..ports.serial import SerialLink
from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import InvalidResponse, ModbusError
from ..protocol.pdu.interface import identify
from ..protocol.values import value_type
from .alternating import Alternating
from .blocking import BUSY, FRAMERS, READ_REGISTERS
from .channel import Channel
from .connection import Connection, State
from .flight import NOT_ASKED, Batch, Flight, Numbered, Statistics
from .pipeline import MAX_IN_FLIGHT
from .plan import Forbidden, Items, Plan, plan_of
from .transport import SerialTransport, TcpTransport, Transport, UdpTransport

__all__ = ["AsyncClient", "State", "Statistics"]

Result = TypeVar("Result")

OnState = Callable[[State, ModbusError | None], object]


class AsyncClient:
    """
    A client of one unit, for asyncio: `Context` with ``await``.

    Connects when entered (``async with``) or used, again on the next request after the
    connection was lost or counts as dead, and closes on exit. All who wait for a
    connection share one attempt and its failure. The next one comes 0.1 s later,
    then 0.2 s, and so on up to 30 s, somewhat less at random, until an answer came;
    a request that cannot wait so long fails at once.

    On "tcp" and "udp" up to `max_in_flight` requests wait for their answers together,
    which come in any order. On serial lines, and these over TCP, it is one request
    at a time, and after a failure the line must be silent for `timeout` before the next:
    an answer that is still to come would be taken for its own. Whoever waits for a
    slot gets it in the order of asking.

    A request may be cancelled at any time, by ``asyncio.timeout`` for one. Its answer is
    dropped when it comes, and the others notice nothing.

    A client belongs to the event loop that uses it first, and to one thread.

    Every request raises, apart from what its method names:

    * TypeError, ValueError: an argument, named with its range; nothing was sent.
    * ExceptionResponse: the server refused; the subclass says why.
    * ModbusTimeoutError: no complete answer within `timeout`.
    * ModbusConnectionError: no connection, or it was lost meanwhile, with errno.
    * FrameError, InvalidResponse: the answer was none.
    * RuntimeError: another event loop.

    Args:
        url: where (`libmodbus_py.url`), such as "tcp://192.0.2.10",
            "rtu:///dev/ttyUSB0?baudrate=9600".
        unit: 0..255; 0 is a broadcast on serial lines: writes only.
        timeout: seconds, 0.001..86400: for a request from when it is sent to the
            end of its answer; and before that, where there is no connection, for
            the wait for one. Waiting for a slot does not count.
        max_in_flight: 1..256; None for 16, and for 1 where only 1 is allowed.
        busy_retries: how often a request is repeated that was refused with
            Acknowledge or ServerDeviceBusy, 0..100, after 0.1, 0.2, 0.4, 0.8, 1, 1... s.
        turnaround: seconds that a request takes which nobody answers.
        request_spacing: seconds between the starts of two requests on the
            connection, at least, for devices that need a rest.
        connect_delay: seconds between connecting and the first request, for devices
            that need to get ready. Neither counts within `timeout`.
        timeouts_before_reconnect: after so many in a row a TCP connection counts as
            dead, 1..1000000: the next request goes over a new one.
        keepalive: seconds of silence after which TCP probes whether the other side is
            there, 1..32767; None for never.
        on_state: called with each new `State`, and the ModbusError that led to it or
            None. It runs in the event loop and must not block.

    Attributes:
        unit: who is asked.
        statistics: what happened on the connection; a live `Statistics`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    unit: int
    statistics: Statistics

    def __init__(
        self,
        url: str,
        *,
        unit: int = 1,
        timeout: float = 1.0,
        max_in_flight: int | None = None,
        busy_retries: int = 0,
        turnaround: float = 0.1,
        request_spacing: float = 0.0,
        connect_delay: float = 0.0,
        timeouts_before_reconnect: int = 3,
        keepalive: float | None = 30.0,
        on_state: OnState | None = None,
    ) -> None:
        self.unit = integer("unit", unit, 0, 255)
        self._busy_retries = integer("busy_retries", busy_retries, 0, 100)
        if on_state is not None and not callable(on_state):
            raise TypeError(f"on_state must be callable, not {type(on_state).__name__}")
        self.statistics = Statistics()
        timeout = seconds("timeout", timeout)
        endpoint = parse(url)
        transport = _transport(endpoint, keepalive)
        self._channel = Channel(
            transport,
            Connection(transport, timeout, self.statistics, on_state),
            _flight(endpoint, max_in_flight, timeout, self.statistics),
            self.statistics,
            timeout=timeout,
            turnaround=seconds("turnaround", turnaround, low=0),
            request_spacing=seconds("request_spacing", request_spacing, low=0),
            connect_delay=seconds("connect_delay", connect_delay, low=0),
            timeouts_before_reconnect=integer(
                "timeouts_before_reconnect", timeouts_before_reconnect, 1, 1_000_000
            ),
        )

    def for_unit(self, unit: int) -> Self:
        """
        Give a handle to another unit, 0..255, on the same connection.

        Closing either handle closes the connection of both.
        """
        handle = copy.copy(self)
        handle.unit = integer("unit", unit, 0, 255)
        return handle

    # --- the connection ------------------------------------------------------------

    @property
    def timeout(self) -> float:
        """Seconds for a connection, and for an answer; settable."""
        return self._channel.timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._channel.timeout = seconds("timeout", value)

    @property
    def state(self) -> State:
        """Where the connection stands."""
        return self._channel.connection.state

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self.state is State.CLOSED

    @property
    def late_answers(self) -> int:
        """How many answers came after their request had been given up, and were dropped."""
        return self.statistics.late_answers

    async def connect(self) -> None:
        """
        Connect, unless connected. Requests do so by themselves.

        Raises:
            ModbusConnectionError: with errno.
            RuntimeError: another event loop.
        """
        await self._channel.connect()

    async def close(self) -> None:
        """
        Close for good; any number of times. What is in flight fails at once.

        Raises:
            RuntimeError: another event loop.
        """
        await self._channel.close()

    async def __aenter__(self) -> Self:
        try:
            await self.connect()
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    # --- the functions --------------------------------------------------------------

    async def execute(self, request: pdu.Request[Result]) -> Result:
        """As `Context.execute`."""
        batch = self._batch([request], "request")
        await self._run(batch)
        result: Result = batch.outcomes[0]
        if isinstance(result, Exception):
            raise result
        return result

    async def execute_many(
        self,
        requests: Iterable[pdu.Request[Any]],
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> list[Any]:
        """
        Send many request objects; as `Context.execute_many`.

        Of these requests no more are in flight than `max_in_flight` of this method,
        and of all requests no more than the client's own.

        With `return_exceptions` a lost connection fails what was in flight on it, and
        a new one carries the rest; an attempt to connect that fails fails the rest.
        Without, requests in flight end before the first failure is raised.
        """
        limit = integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        if not isinstance(requests, Iterable):
            raise TypeError(f"requests must be a list, not {type(requests).__name__}")
        batch = self._batch(
            list(requests), "requests[{}]", limit=limit, go_on=bool(return_exceptions)
        )
        if batch.requests:
            await self._run(batch)
        for outcome in batch.outcomes:
            if isinstance(outcome, Exception) and not (
                return_exceptions and isinstance(outcome, ModbusError)
            ):
                raise outcome
        return batch.outcomes

    def _batch(self, requests: Sequence[pdu.Request[Any]], name: str, **options: Any) -> Batch:
        """Check and encode all before the first is sent."""
        is_broadcast = self.unit == 0 and self._channel.flight.has_broadcast
        pdus, silent = [], []
        for index, request in enumerate(requests):
            if not isinstance(request, pdu.Request):
                given = type(request).__name__
                raise TypeError(f"{name.format(index)} must be one of pdu, not {given}")
            if is_broadcast and not request.is_write:
                raise ValueError(
                    f"{name.format(index)}: unit 0 is a broadcast, which nobody answers: "
                    f"{request} is no write"
                )
            encoded = request.encode()
            if not 1 <= len(encoded) <= pdu.MAX_PDU:
                raise ValueError(
                    f"{name.format(index)} must encode to 1..{pdu.MAX_PDU} bytes, "
                    f"not {len(encoded)}"
                )
            pdus.append(encoded)
            if is_broadcast or not request.expects_response:
                silent.append(index)
        return Batch(self.unit, requests, pdus, frozenset(silent), **options)

    async def _run(self, batch: Batch) -> None:
        await self._channel.run(batch)
        for number in range(self._busy_retries):
            outcomes = batch.outcomes
            failed = [each for each in outcomes if isinstance(each, Exception)]
            busy = [each for each in failed if isinstance(each, BUSY)]
            if not busy or (len(busy) < len(failed) and not batch.go_on):
                return
            await asyncio.sleep(min(1.0, 0.1 * 2**number))
            # Who must not go on has stopped at the busy one.
            left = [
                index
                for index, each in enumerate(outcomes)
                if each is NOT_ASKED or isinstance(each, BUSY)
            ]
            again = Batch(
                batch.unit,
                [batch.requests[index] for index in left],
                [batch.pdus[index] for index in left],
                frozenset(at for at, index in enumerate(left) if index in batch.silent),
                limit=batch.limit,
                go_on=batch.go_on,
            )
            await self._channel.run(again)
            for index, outcome in zip(left, again.outcomes, strict=True):
                outcomes[index] = outcome

    async def read_many(
        self,
        items: Plan | Items,
        *,
        gap: int = 0,
        forbidden: Forbidden = (),
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> Any:
        """Read many things in few requests; as `Context.read_many`."""
        plan = plan_of(items, gap=gap, forbidden=forbidden)
        return plan.results(
            await self.execute_many(
                plan.requests, max_in_flight=max_in_flight, return_exceptions=return_exceptions
            )
        )

    async def read_coils(self, address: int, count: int) -> list[bool]:
        """Read 1..2000 coils (function 1)."""
        return await self.execute(pdu.ReadCoils(address, count))

    async def read_discrete_inputs(self, address: int, count: int) -> list[bool]:
        """Read 1..2000 discrete inputs (function 2)."""
        return await self.execute(pdu.ReadDiscreteInputs(address, count))

    async def read_holding_registers(self, address: int, count: int) -> list[int]:
        """Read 1..125 holding registers (function 3)."""
        return await self.execute(pdu.ReadHoldingRegisters(address, count))

    async def read_input_registers(self, address: int, count: int) -> list[int]:
        """Read 1..125 input registers (function 4)."""
        return await self.execute(pdu.ReadInputRegisters(address, count))

    async def write_coil(self, address: int, value: bool) -> None:
        """Write one coil (function 5)."""
        await self.execute(pdu.WriteCoil(address, value))

    async def write_register(self, address: int, value: int) -> None:
        """Write one holding register, 0..65535 (function 6)."""
        await self.execute(pdu.WriteRegister(address, value))

    async def write_coils(self, address: int, values: Iterable[bool]) -> None:
        """Write 1..1968 coils (function 15)."""
        await self.execute(pdu.WriteCoils(address, values))  # type: ignore[arg-type]

    async def write_registers(self, address: int, values: Iterable[int]) -> None:
        """Write 1..123 holding registers (function 16)."""
        await self.execute(pdu.WriteRegisters(address, values))  # type: ignore[arg-type]

    async def read_exception_status(self) -> int:
        """Read the eight exception status outputs, lowest in bit 0 (function 7)."""
        return await self.execute(pdu.ReadExceptionStatus())

    async def diagnostics(self, sub_function: int, data: int = 0) -> int:
        """Run a diagnostic sub-function (function 8); as `Context.diagnostics`."""
        word = integer("data", data, 0, 0xFFFF).to_bytes(2, "big")
        answer = await self.execute(pdu.Diagnostics(sub_function, word))
        return data if answer is None else int.from_bytes(answer, "big")

    async def read_comm_event_counter(self) -> pdu.CommEventCounter:
        """Read the status word and the event counter (function 11)."""
        return await self.execute(pdu.ReadCommEventCounter())

    async def read_comm_event_log(self) -> pdu.CommEventLog:
        """Read the counters and up to 64 events, newest first (function 12)."""
        return await self.execute(pdu.ReadCommEventLog())

    async def report_server_id(self) -> pdu.ServerId:
        """Read what the device is and whether it runs (function 17)."""
        return await self.execute(pdu.ReportServerId())

    async def read_file_records(self, records: Sequence[tuple[int, int, int]]) -> list[list[int]]:
        """Read pieces of files (function 20); as `Context.read_file_records`."""
        return await self.execute(pdu.ReadFileRecords(records))  # type: ignore[arg-type]

    async def write_file_records(self, records: Sequence[tuple[int, int, Iterable[int]]]) -> None:
        """Write pieces of files (function 21); as `Context.write_file_records`."""
        await self.execute(pdu.WriteFileRecords(records))  # type: ignore[arg-type]

    async def mask_write_register(self, address: int, and_mask: int, or_mask: int) -> None:
        """Set a register to (current AND and_mask) OR (or_mask AND NOT and_mask) (function 22)."""
        await self.execute(pdu.MaskWriteRegister(address, and_mask, or_mask))

    async def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, values: Iterable[int]
    ) -> list[int]:
        """Write 1..121 holding registers, then read 1..125 (function 23)."""
        return await self.execute(
            pdu.ReadWriteRegisters(read_address, read_count, write_address, values)  # type: ignore[arg-type]
        )

    async def read_fifo_queue(self, address: int) -> list[int]:
        """Read the 0..31 registers of a queue, which keeps them (function 24)."""
        return await self.execute(pdu.ReadFifoQueue(address))

    async def read_device_identification(
        self, level: str | int = "basic"
    ) -> pdu.DeviceIdentification:
        """Read what a device says about itself (43/14); as `Context.read_device_identification`."""
        steps = identify(level)
        request = next(steps)
        while True:
            page = await self.execute(request)
            try:
                request = steps.send(page)
            except StopIteration as done:
                result: pdu.DeviceIdentification = done.value
                return result
            except InvalidResponse as error:
                error.unit = self.unit
                raise

    async def encapsulated_transport(self, mei_type: int, data: bytes) -> bytes:
        """Send up to 251 bytes to an encapsulated interface (43); `Context` has more on it."""
        return await self.execute(pdu.EncapsulatedTransport(mei_type, data))

    # --- values ----------------------------------------------------------------------

    async def read_values(
        self,
        table: str,
        address: int,
        type: str,
        count: int = 1,
        *,
        order: str = "ABCD",
        **text: str,
    ) -> list[Any]:
        """Read numbers, text or bits out of registers; as `Context.read_values`."""
        if table not in READ_REGISTERS:
            raise ValueError(f"table must be one of {', '.join(READ_REGISTERS)}, not {table!r}")
        kind = value_type(type, order=order, **text)
        registers = kind.registers * integer("count", count, 1, 125 // kind.registers)
        cells = await self.execute(READ_REGISTERS[table](address, registers))
        return kind.decode_many(cells)

    async def write_values(
        self,
        table: str,
        address: int,
        values: Iterable[Any],
        type: str,
        *,
        order: str = "ABCD",
        **text: str,
    ) -> None:
        """Write numbers, text or bits to registers; as `Context.write_values`."""
        if table != "holding_registers":
            raise ValueError(f"table must be holding_registers, not {table!r}")
        kind = value_type(type, order=order, **text)
        await self.write_registers(address, kind.encode_many(values))


def _transport(endpoint: Endpoint, keepalive: float | None) -> Transport:
    if keepalive is not None:
        keepalive = seconds("keepalive", keepalive, 1, 32_767)
    if endpoint.transport == "serial":
        # As `AsciiContext` has them: ASCII frames have marks of their own.
        usual = {"data_bits": 7, "silence": 0.0} if endpoint.framing == "ascii" else {}
        return SerialTransport(SerialLink(endpoint.device, **{**usual, **endpoint.options}))
    if "\0" in endpoint.host:
        raise ValueError(f"host must be a name or an address, not {endpoint.host!r}")
    port = integer("port", endpoint.port, 1, 65535)
    if endpoint.transport == "udp":
        return UdpTransport(endpoint.host, port)
    return TcpTransport(endpoint.host, port, keepalive)


def _flight(
    endpoint: Endpoint, max_in_flight: int | None, timeout: float, statistics: Statistics
) -> Flight:
    make_framer = FRAMERS[endpoint.framing]
    limit = None
    if max_in_flight is not None:
        limit = integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
    if endpoint.framing in ("tcp", "udp"):
        return Numbered(make_framer, limit or 16, timeout, statistics)
    if limit not in (None, 1):
        raise ValueError(
            f"max_in_flight must be 1 on {endpoint.scheme}, whose answers carry no transaction id"
        )
    return Alternating(make_framer, timeout, statistics)
