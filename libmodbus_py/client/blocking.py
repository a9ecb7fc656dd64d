"""
The blocking client: one method for each function, on libmodbus.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Literal, Self, TypeVar

from ..ports import endpoint as url
from ..ports.link import Link
from ..ports.serial import SerialLink
from ..ports.tcp_link import TcpLink
from ..ports.udp_link import UdpLink
from ..protocol import pdu
from ..protocol.checks import integer, seconds
from ..protocol.errors import Acknowledge, InvalidResponse, ModbusError, ServerDeviceBusy
from ..protocol.framing import AsciiFramer, RtuFramer, TcpFramer, UdpFramer
from ..protocol.pdu.interface import identify
from ..protocol.values import value_type
from .line import Line
from .pipeline import MAX_IN_FLIGHT, one_by_one
from .plan import Forbidden, Items, Plan, plan_of

__all__ = ["AsciiContext", "Context", "RtuContext", "TcpContext", "UdpContext"]

Result = TypeVar("Result")

FRAMERS: dict[str, Any] = {
    "tcp": TcpFramer,
    "rtu": partial(RtuFramer, role="client"),
    "ascii": AsciiFramer,
    "udp": UdpFramer,
}

BUSY = (Acknowledge, ServerDeviceBusy)


class Context:
    """
    A client of one unit: a `TcpContext`, `UdpContext`, `RtuContext` or `AsciiContext`.

    Connects when entered (``with``) or used, again on the next request after
    the connection was lost or stayed dumb for three timeouts, and closes on exit.
    Safe from any thread: one request at a time, the others wait. After a fork the
    child connects anew and the parent notices nothing.

    Addresses are 0-based, 0..65535; timeouts are in seconds.

    Every request raises, apart from what its method names:

    * TypeError, ValueError: an argument, named with its range; nothing was sent.
    * ExceptionResponse: the server refused; the subclass says why.
    * ModbusTimeoutError: no complete answer within `timeout`.
    * ModbusConnectionError: no connection, with errno.
    * FrameError, InvalidResponse: the answer was none.

    After any of the last three, a serial line must be silent for `timeout` before the
    next request goes out: an answer that is still to come would be taken for its own.

    The requests that libmodbus knows are carried by libmodbus, without the GIL;
    Ctrl-C then takes effect when it returns, after `timeout` at most.

    Attributes:
        unit: who is asked.
    """

    unit: int

    def __init__(self, line: Line, unit: int, busy_retries: int) -> None:
        self._line = line
        self.unit = integer("unit", unit, 0, 255)
        self._busy_retries = integer("busy_retries", busy_retries, 0, 100)

    @staticmethod
    def from_url(address: str, **options: Any) -> Context:
        """
        Make the context for a URL (`libmodbus_py.url`).

        Args:
            address: such as "tcp://192.0.2.10" or "rtu:///dev/ttyUSB0?baudrate=9600".
            options: as for the class: unit, timeout, ...

        Raises:
            TypeError, ValueError: the URL or an option is wrong.
        """
        endpoint = url.parse(address)
        if endpoint.framing == "udp":
            return UdpContext(endpoint.host, endpoint.port, **options)
        if endpoint.transport == "tcp":
            return TcpContext(endpoint.host, endpoint.port, framing=endpoint.framing, **options)
        kind = RtuContext if endpoint.framing == "rtu" else AsciiContext
        return kind(endpoint.device, **endpoint.options, **options)

    def for_unit(self, unit: int) -> Self:
        """
        Give a handle to another unit, 0..255, on the same connection.

        Unit 0 is a broadcast on serial lines: writes only, which return after
        the turnaround delay. Closing either handle closes the connection of both.
        """
        handle = copy.copy(self)
        handle.unit = integer("unit", unit, 0, 255)
        return handle

    # --- the connection ------------------------------------------------------------

    @property
    def timeout(self) -> float:
        """Seconds that one request may take, connecting included; settable."""
        return self._line.timeout

    @timeout.setter
    def timeout(self, value: float) -> None:
        self._line.set_timeout(seconds("timeout", value))

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._line.closed

    @property
    def late_answers(self) -> int:
        """How many answers came after their timeout and were dropped."""
        return self._line.late_answers

    def connect(self) -> None:
        """
        Connect, unless connected. Requests do so by themselves.

        Raises:
            ModbusConnectionError: with errno.
        """
        self._line.open()

    def close(self) -> None:
        """
        Close for good; any number of times, from any thread.

        A TCP request that another thread waits for fails at once; one on a serial
        line ends first.
        """
        self._line.close()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- the functions --------------------------------------------------------------

    def execute(self, request: pdu.Request[Result]) -> Result:
        """
        Send any request object of `libmodbus_py.pdu`.

        Returns:
            What the method of the same name returns.
        """
        if self._busy_retries:
            for pause in _pauses(self._busy_retries):
                try:
                    return self._line.execute(self.unit, request)
                except BUSY:
                    time.sleep(pause)
        return self._line.execute(self.unit, request)

    def execute_many(
        self,
        requests: Iterable[pdu.Request[Any]],
        *,
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> list[Any]:
        """
        Send many request objects, several at a time where answers can be told apart.

        On "tcp" and "udp" up to `max_in_flight` requests wait for their answers
        together; `timeout` counts for each from when it is sent, and other threads wait
        until all are done. A server may carry them out in any order: writes that depend on
        each other need ``max_in_flight=1``. Then, on the other framings, and
        with a request that nobody answers among them, they go one after the other.

        With `return_exceptions` the rest goes on whatever fails. A lost connection fails
        all that was in flight on it, and a new one carries the rest; after
        three in a row that could not be made or brought no answer the rest fails, too.

        `busy_retries` counts for each request. Those in flight together are asked again
        together, after the others.

        Args:
            requests: request objects of `libmodbus_py.pdu`; all are checked before the
                first is sent.
            max_in_flight: 1..256; servers need not take more than 16 (TCP guide,
                section 4.3).
            return_exceptions: whether a ModbusError is given in the place of its
                result; else the first in the order of requests is raised, nothing more is
                sent, and answers that are still to come are dropped when they do.

        Returns:
            The results in the order of the requests.

        Raises:
            TypeError, ValueError: `max_in_flight`, or a request, which is named
                by its index (``requests[3]``).
        """
        limit = integer("max_in_flight", max_in_flight, 1, MAX_IN_FLIGHT)
        asked = self._checked_requests(requests)
        if limit == 1 or not self._line.can_pipeline(asked):
            return one_by_one(self.execute, asked, return_exceptions=return_exceptions)
        outcomes = self._execute_together(asked, limit, return_exceptions)
        if not return_exceptions:
            for outcome in outcomes:
                if isinstance(outcome, ModbusError):
                    raise outcome
        return outcomes

    def _checked_requests(self, requests: object) -> list[pdu.Request[Any]]:
        if not isinstance(requests, Iterable):
            raise TypeError(f"requests must be a list, not {type(requests).__name__}")
        asked = list(requests)
        for at, request in enumerate(asked):
            self._line.check(self.unit, request, f"requests[{at}]")
        return asked

    def _execute_together(
        self, asked: list[pdu.Request[Any]], limit: int, return_exceptions: bool
    ) -> list[Any]:
        tolerated = (ModbusError,) if return_exceptions else BUSY if self._busy_retries else ()
        send = partial(self._line.execute_many, self.unit, max_in_flight=limit, tolerated=tolerated)
        outcomes = send(asked)
        for pause in _pauses(self._busy_retries):
            busy = [at for at, outcome in enumerate(outcomes) if isinstance(outcome, BUSY)]
            if not busy:
                break
            time.sleep(pause)
            again = send([asked[at] for at in busy])
            for at, outcome in zip(busy, again, strict=True):
                outcomes[at] = outcome
        return outcomes

    def read_many(
        self,
        items: Plan | Items,
        *,
        gap: int = 0,
        forbidden: Forbidden = (),
        max_in_flight: int = 16,
        return_exceptions: bool = False,
    ) -> Any:
        """
        Read many things in few requests.

        Args:
            items: a `plan.Plan`; or what makes one, such as
                ``{"level": ("holding_registers", 100, 1, "float32"), "valves": ("coils", 0, 8)}``.
            gap, forbidden: of the plan, where `items` is none.
            max_in_flight: as for `execute_many`.
            return_exceptions: whether a ModbusError is given in the place of what
                was to come with a failed request; else it is raised.

        Returns:
            A list of values for each item, in their order; a dict where `items`
            was a mapping.

        Raises:
            TypeError, ValueError: as of `plan.Plan`; registers that hold no such value.
            IllegalDataAddress: a merged request covers cells that the device
                lacks: see `plan.Plan`.
        """
        plan = plan_of(items, gap=gap, forbidden=forbidden)
        return plan.results(
            self.execute_many(
                plan.requests, max_in_flight=max_in_flight, return_exceptions=return_exceptions
            )
        )

    def read_coils(self, address: int, count: int) -> list[bool]:
        """Read 1..2000 coils (function 1, modbus_read_bits)."""
        return self.execute(pdu.ReadCoils(address, count))

    def read_discrete_inputs(self, address: int, count: int) -> list[bool]:
        """Read 1..2000 discrete inputs (function 2, modbus_read_input_bits)."""
        return self.execute(pdu.ReadDiscreteInputs(address, count))

    def read_holding_registers(self, address: int, count: int) -> list[int]:
        """Read 1..125 holding registers (function 3, modbus_read_registers)."""
        return self.execute(pdu.ReadHoldingRegisters(address, count))

    def read_input_registers(self, address: int, count: int) -> list[int]:
        """Read 1..125 input registers (function 4, modbus_read_input_registers)."""
        return self.execute(pdu.ReadInputRegisters(address, count))

    def write_coil(self, address: int, value: bool) -> None:
        """Write one coil (function 5, modbus_write_bit)."""
        self.execute(pdu.WriteCoil(address, value))

    def write_register(self, address: int, value: int) -> None:
        """Write one holding register, 0..65535 (function 6, modbus_write_register)."""
        self.execute(pdu.WriteRegister(address, value))

    def write_coils(self, address: int, values: Iterable[bool]) -> None:
        """Write 1..1968 coils (function 15, modbus_write_bits)."""
        self.execute(pdu.WriteCoils(address, values))  # type: ignore[arg-type]

    def write_registers(self, address: int, values: Iterable[int]) -> None:
        """Write 1..123 holding registers (function 16, modbus_write_registers)."""
        self.execute(pdu.WriteRegisters(address, values))  # type: ignore[arg-type]

    def read_exception_status(self) -> int:
        """Read the eight exception status outputs, lowest in bit 0 (function 7)."""
        return self.execute(pdu.ReadExceptionStatus())

    def diagnostics(self, sub_function: int, data: int = 0) -> int:
        """
        Run a diagnostic sub-function (function 8).

        Args:
            sub_function: 0..65535; `pdu.SubFunction` names them.
            data: 0..65535; FF00h makes a restart clear the event log, and a
                new ASCII delimiter stands in the high byte.

        Returns:
            The data of the answer; `data` for "force listen only", which
            nobody answers. `execute(pdu.Diagnostics(0, data))` echoes up to 250 bytes.
        """
        word = integer("data", data, 0, 0xFFFF).to_bytes(2, "big")
        answer = self.execute(pdu.Diagnostics(sub_function, word))
        return data if answer is None else int.from_bytes(answer, "big")

    def read_comm_event_counter(self) -> pdu.CommEventCounter:
        """Read the status word and the event counter (function 11)."""
        return self.execute(pdu.ReadCommEventCounter())

    def read_comm_event_log(self) -> pdu.CommEventLog:
        """Read the counters and up to 64 events, newest first (function 12)."""
        return self.execute(pdu.ReadCommEventLog())

    def report_server_id(self) -> pdu.ServerId:
        """
        Read what the device is and whether it runs (function 17, modbus_report_slave_id).

        Returns:
            With an identifier of one byte; ``pdu.ServerId.split(answer.data, length)``
            for devices that have a longer one.
        """
        return self.execute(pdu.ReportServerId())

    def read_file_records(self, records: Sequence[tuple[int, int, int]]) -> list[list[int]]:
        """
        Read pieces of files (function 20, by this package).

        Args:
            records: 1..35 tuples (file 1..65535, first record 0..9999, length).

        Returns:
            The registers of each piece.
        """
        return self.execute(pdu.ReadFileRecords(records))  # type: ignore[arg-type]

    def write_file_records(self, records: Sequence[tuple[int, int, Iterable[int]]]) -> None:
        """
        Write pieces of files (function 21, by this package).

        Args:
            records: tuples (file 1..65535, first record 0..9999, values).
        """
        self.execute(pdu.WriteFileRecords(records))  # type: ignore[arg-type]

    def mask_write_register(self, address: int, and_mask: int, or_mask: int) -> None:
        """
        Set a holding register to (current AND and_mask) OR (or_mask AND NOT and_mask).

        Function 22, modbus_mask_write_register.
        """
        self.execute(pdu.MaskWriteRegister(address, and_mask, or_mask))

    def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, values: Iterable[int]
    ) -> list[int]:
        """
        Write 1..121 holding registers, then read 1..125.

        Function 23, modbus_write_and_read_registers.
        """
        return self.execute(
            pdu.ReadWriteRegisters(read_address, read_count, write_address, values)  # type: ignore[arg-type]
        )

    def read_fifo_queue(self, address: int) -> list[int]:
        """Read the 0..31 registers of a queue, which keeps them (function 24)."""
        return self.execute(pdu.ReadFifoQueue(address))

    def read_device_identification(self, level: str | int = "basic") -> pdu.DeviceIdentification:
        """
        Read what a device says about itself (function 43/14), in as many requests as it takes.

        Args:
            level: "basic", "regular" or "extended"; or the id of a single object, 0..255.

        Raises:
            InvalidResponse: the device would never come to an end.
        """
        steps = identify(level)
        request = next(steps)
        while True:
            page = self.execute(request)
            try:
                request = steps.send(page)
            except StopIteration as done:
                result: pdu.DeviceIdentification = done.value
                return result
            except InvalidResponse as error:
                error.unit = self.unit
                raise

    def encapsulated_transport(self, mei_type: int, data: bytes) -> bytes:
        """
        Send up to 251 bytes to an encapsulated interface (function 43).

        Args:
            mei_type: 0..255; 13 is CANopen.
            data: sent as it is.

        Returns:
            The data of the answer.
        """
        return self.execute(pdu.EncapsulatedTransport(mei_type, data))

    # --- values ----------------------------------------------------------------------

    def read_values(
        self,
        table: str,
        address: int,
        type: str,
        count: int = 1,
        *,
        order: str = "ABCD",
        **text: str,
    ) -> list[Any]:
        """
        Read numbers, text or bits out of registers, in one request.

        Args:
            table: "holding_registers" or "input_registers".
            address: the first register.
            type: such as "float32"; see `libmodbus_py.values`.
            count: how many values, up to what 125 registers hold.
            order: ABCD, CDAB, BADC or DCBA.
            text: encoding and padding of strings.
        """
        if table not in READ_REGISTERS:
            raise ValueError(f"table must be one of {', '.join(READ_REGISTERS)}, not {table!r}")
        kind = value_type(type, order=order, **text)
        registers = kind.registers * integer("count", count, 1, 125 // kind.registers)
        cells = self.execute(READ_REGISTERS[table](address, registers))
        return kind.decode_many(cells)

    def write_values(
        self,
        table: str,
        address: int,
        values: Iterable[Any],
        type: str,
        *,
        order: str = "ABCD",
        **text: str,
    ) -> None:
        """
        Write numbers, text or bits to registers, in one request.

        Args:
            table: "holding_registers"; others cannot be written.
            address: the first register.
            values: one or more, up to what 123 registers hold.
            type, order, text: as for `read_values`.
        """
        if table != "holding_registers":
            raise ValueError(f"table must be holding_registers, not {table!r}")
        self.write_registers(address, value_type(type, order=order, **text).encode_many(values))


READ_REGISTERS: dict[str, Callable[[int, int], pdu.Request[list[int]]]] = {
    "holding_registers": pdu.ReadHoldingRegisters,
    "input_registers": pdu.ReadInputRegisters,
}


class TcpContext(Context):
    """
    A client over TCP.

    Args:
        host: a name, an IPv4 or an IPv6 address. Resolving a name takes as long
            as the system takes.
        port: 1..65535.
        unit: 0..255; a server without a gateway takes any.
        timeout: seconds for a request, 0.001..86400.
        framing: "tcp" (MBAP); "rtu" or "ascii" for such a line behind a
            serial device server.
        native: True lets libmodbus carry all it knows; it does not check the
            unit of answers. False lets this package do it, with strict checks,
            all bytes in errors and Ctrl-C at once. None: libmodbus carries what
            was answered rightly once.
        turnaround: seconds that a broadcast takes, on "rtu" and "ascii".
        busy_retries: how often a request is repeated that was refused with
            Acknowledge or ServerDeviceBusy, 0..100, after 0.1, 0.2, 0.4, 0.8, 1, 1... s.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        host: str,
        port: int = url.DEFAULT_PORT,
        *,
        unit: int = 1,
        timeout: float = 1.0,
        framing: Literal["tcp", "rtu", "ascii"] = "tcp",
        native: bool | None = None,
        turnaround: float = 0.1,
        busy_retries: int = 0,
    ) -> None:
        if framing not in ("tcp", "rtu", "ascii"):
            raise ValueError(f"framing must be one of tcp, rtu, ascii, not {framing!r}")
        line = _line(TcpLink(host, port), framing, timeout, turnaround, native, framing == "tcp")
        super().__init__(line, unit, busy_retries)


class UdpContext(Context):
    """
    A client over UDP: the frames of Modbus/TCP, each in a datagram, carried by this package.

    The network may lose or double datagrams. A request that gets no answer is a
    ModbusTimeoutError and is not repeated, for nobody knows whether it was
    carried out. Damaged datagrams and those of other hosts do not end the wait.

    Args:
        host: a name, an IPv4 or an IPv6 address. Resolving a name takes as long
            as the system takes.
        port: 1..65535.
        unit: 0..255; a server without a gateway takes any.
        timeout: seconds for a request, 0.001..86400.
        busy_retries: as for `TcpContext`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        host: str,
        port: int = url.DEFAULT_PORT,
        *,
        unit: int = 1,
        timeout: float = 1.0,
        busy_retries: int = 0,
    ) -> None:
        line = _line(UdpLink(host, port), "udp", timeout, 0, False, False)
        super().__init__(line, unit, busy_retries)


class RtuContext(Context):
    """
    A client on a serial line in RTU mode.

    Args:
        device: such as "/dev/ttyUSB0"; locked while open, so that no two
            programs talk at once.
        baudrate: bits per second.
        parity: "E", "O" or "N".
        data_bits: 8 in RTU mode.
        stop_bits: 1 or 2.
        unit: 1..247; 0 is a broadcast.
        timeout: seconds for a request, 0.001..86400; more than the slowest
            unit needs, for a late answer cannot be told from the next one.
        native: as for `TcpContext`.
        rs485: None; "kernel", the driver turns the transceiver round;
            "rts-up" or "rts-down", RTS is set or cleared while we send.
        rts_delay: seconds between RTS and the first bit and after the last;
            None for one character.
        echo: whether all that is sent comes back; libmodbus cannot cope with
            that, so this package carries all requests.
        silence: seconds of quiet before a request; None for 3.5 characters
            (1.75 ms above 19200 bit/s; serial line, 2.5.1.1).
        turnaround: seconds that a broadcast takes (serial line, 2.4.1).
        busy_retries: as for `TcpContext`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        device: str,
        baudrate: int = 19200,
        *,
        parity: Literal["N", "E", "O"] = "E",
        data_bits: int = 8,
        stop_bits: int = 1,
        unit: int = 1,
        timeout: float = 1.0,
        native: bool | None = None,
        rs485: Literal["kernel", "rts-up", "rts-down"] | None = None,
        rts_delay: float | None = None,
        echo: bool = False,
        silence: float | None = None,
        turnaround: float = 0.1,
        busy_retries: int = 0,
    ) -> None:
        link = SerialLink(
            device,
            baudrate,
            parity=parity,
            data_bits=data_bits,
            stop_bits=stop_bits,
            rs485=rs485,
            rts_delay=rts_delay,
            echo=echo,
            silence=silence,
        )
        line = _line(link, "rtu", timeout, turnaround, native, not echo)
        super().__init__(line, unit, busy_retries)


class AsciiContext(Context):
    """
    A client on a serial line in ASCII mode, which libmodbus lacks.

    libmodbus opens and configures the port; this package does the talking.
    Arguments as for `RtuContext`, without `silence`; `data_bits` is 7 in ASCII mode, and
    `native` changes nothing, for libmodbus carries none of its requests.
    """

    def __init__(
        self,
        device: str,
        baudrate: int = 19200,
        *,
        parity: Literal["N", "E", "O"] = "E",
        data_bits: int = 7,
        stop_bits: int = 1,
        unit: int = 1,
        timeout: float = 1.0,
        native: bool | None = None,
        rs485: Literal["kernel", "rts-up", "rts-down"] | None = None,
        rts_delay: float | None = None,
        echo: bool = False,
        turnaround: float = 0.1,
        busy_retries: int = 0,
    ) -> None:
        link = SerialLink(
            device,
            baudrate,
            parity=parity,
            data_bits=data_bits,
            stop_bits=stop_bits,
            rs485=rs485,
            rts_delay=rts_delay,
            echo=echo,
            silence=0,  # ASCII frames have marks of their own
        )
        line = _line(link, "ascii", timeout, turnaround, native, False)
        super().__init__(line, unit, busy_retries)


def _pauses(count: int) -> Iterator[float]:
    return (min(1.0, 0.1 * 2**number) for number in range(count))


def _line(
    link: Link,
    framing: str,
    timeout: float,
    turnaround: float,
    native: bool | None,
    speaks: bool,
) -> Line:
    make_framer: Any = FRAMERS[framing]
    return Line(
        link,
        make_framer,
        timeout=seconds("timeout", timeout),
        turnaround=seconds("turnaround", turnaround, low=0),
        native=native,
        speaks=speaks,
    )
