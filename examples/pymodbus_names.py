"""
The clients of pymodbus on libmodbus-py, for programs written for pymodbus 3.

In place of `from pymodbus.client import ModbusTcpClient`:

    from pymodbus_names import ModbusTcpClient

For a package that cannot be changed, before it is imported:

    import sys
    import pymodbus_names

    for name in ("pymodbus", "pymodbus.client", "pymodbus.exceptions"):
        sys.modules[name] = pymodbus_names

These clients have the eight methods that read and write coils and registers. `client.unit(17)` is
the client of libmodbus-py behind them, with all others.
"""

import asyncio

from libmodbus_py import AsyncClient, Client, ExceptionResponse, State
from libmodbus_py import ModbusConnectionError as ConnectionException
from libmodbus_py import ModbusError as ModbusException
from libmodbus_py import ModbusTimeoutError as ModbusIOException

__all__ = [
    "AsyncModbusSerialClient", "AsyncModbusTcpClient", "AsyncModbusUdpClient",
    "ConnectionException", "ModbusException", "ModbusIOException",
    "ModbusSerialClient", "ModbusTcpClient", "ModbusUdpClient",
]  # fmt: skip


class Answer:
    """The result of a request, or its refusal."""

    def __init__(self, values=None, exception_code=0):
        self.registers = self.bits = values if isinstance(values, list) else []
        self.exception_code = exception_code

    def isError(self):
        return self.exception_code > 0


def reads(name):
    def method(self, address, *, count=1, device_id=1, slave=None, **_):
        return self._answer(name, device_id if slave is None else slave, address, count)

    return method


def writes(name):
    def method(self, address, value, *, device_id=1, slave=None, **_):
        return self._answer(name, device_id if slave is None else slave, address, value)

    return method


class Functions:
    _client = None  # pymodbus connects again after close(), a client of libmodbus-py does not

    def _open(self, url, timeout=3, retries=3, **_):
        self._make = lambda: self._kind(url, timeout=timeout, retries=retries)

    @property
    def connected(self):
        return self._client is not None and self._client.state is State.CONNECTED

    def unit(self, number):
        self._client = self._client or self._make()
        return self._client.for_unit(number)

    read_coils = reads("read_coils")
    read_discrete_inputs = reads("read_discrete_inputs")
    read_holding_registers = reads("read_holding_registers")
    read_input_registers = reads("read_input_registers")
    write_coil = writes("write_coil")
    write_register = writes("write_register")
    write_coils = writes("write_coils")
    write_registers = writes("write_registers")


class Blocking(Functions):
    _kind = Client

    def _answer(self, name, number, *arguments):
        try:
            return Answer(getattr(self.unit(number), name)(*arguments))
        except ExceptionResponse as error:
            return Answer(exception_code=error.code)

    def connect(self):
        try:
            self.unit(1).connect()
        except ConnectionException:
            return False
        return True

    def close(self):
        if self._client:
            self._client.close()
        self._client = None

    def __enter__(self):
        self.connect()
        return self

    def __exit__(self, *_):
        self.close()


class Asyncio(Functions):
    _kind = AsyncClient

    async def _answer(self, name, number, *arguments):
        try:
            return Answer(await getattr(self.unit(number), name)(*arguments))
        except ExceptionResponse as error:
            return Answer(exception_code=error.code)

    async def connect(self):
        try:
            await self.unit(1).connect()
        except ConnectionException:
            return False
        return True

    def close(self):
        if self._client:
            self._closing = asyncio.ensure_future(self._client.close())
        self._client = None

    async def __aenter__(self):
        await self.connect()
        return self

    async def __aexit__(self, *_):
        if self._client:
            await self._client.close()
        self._client = None


class Network:
    def __init__(self, host, *, port=502, framer="socket", **options):
        framing = str(getattr(framer, "value", framer))
        scheme = self._transport if framing == "socket" else f"{framing}+{self._transport}"
        self._open(f"{scheme}://{host}:{port}", **options)


class Serial:
    def __init__(
        self, port, *, framer="rtu", baudrate=19200, bytesize=8, parity="N", stopbits=1, **options
    ):
        framing = getattr(framer, "value", framer)
        settings = f"baudrate={baudrate}&data_bits={bytesize}&parity={parity}&stop_bits={stopbits}"
        self._open(f"{framing}://{port}?{settings}", **options)


class ModbusTcpClient(Network, Blocking):
    _transport = "tcp"


class ModbusUdpClient(Network, Blocking):
    _transport = "udp"


class ModbusSerialClient(Serial, Blocking):
    pass


class AsyncModbusTcpClient(Network, Asyncio):
    _transport = "tcp"


class AsyncModbusUdpClient(Network, Asyncio):
    _transport = "udp"


class AsyncModbusSerialClient(Serial, Asyncio):
    pass
