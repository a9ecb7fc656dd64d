"""
Names of libmodbus and of other packages for Modbus, and what is typed here in their place.
"""

from __future__ import annotations

import re
import sys

CLIENT = 'Client("tcp://HOST:PORT", unit=1)'
ASYNC_CLIENT = f"Async{CLIENT}"
SERIAL_CLIENT = 'Client("rtu:///dev/ttyUSB0?baudrate=9600&parity=N", unit=1)'
SERVER = 'Server(device).serve_forever("tcp://0.0.0.0:502")'
MAPPING = "Device(Mapping(holding_registers=100))"
VALUES = 'client.read_value("holding_registers", address, "float32", order="CDAB")'

NAMES = {
    "modbus_new_rtu": "RtuContext(device, baudrate, parity, data_bits, stop_bits)",
    **dict.fromkeys(("modbus_new_tcp", "modbus_new_tcp_pi"), "TcpContext(host, port)"),
    **dict.fromkeys(("modbus_mapping_new", "modbus_mapping_new_start_address"), MAPPING),
    **dict.fromkeys(("ModbusTcpClient", "ModbusTcp", "ModbusClient", "TcpClient"), CLIENT),
    "ModbusUdpClient": 'Client("udp://HOST:PORT", unit=1)',
    "ModbusTlsClient": 'Client("tls://HOST:PORT", unit=1)',
    **dict.fromkeys(("ModbusSerialClient", "ModbusRtu", "Instrument", "RtuClient"), SERIAL_CLIENT),
    **dict.fromkeys(("AsyncModbusTcpClient", "AsyncTcpClient"), ASYNC_CLIENT),
    "AsyncModbusSerialClient": "Async" + SERIAL_CLIENT,
    "ModbusException": "ModbusError",
    "ConnectionException": "ModbusConnectionError",
    "ModbusIOException": "ModbusTimeoutError",
    **dict.fromkeys(("StartTcpServer", "ModbusTcpServer", "ModbusServer", "TcpServer"), SERVER),
    "StartAsyncTcpServer": 'async with Server(device).serving("tcp://0.0.0.0:502")',
    **dict.fromkeys(("ModbusSequentialDataBlock", "ModbusSparseDataBlock", "DataBank"), MAPPING),
    **dict.fromkeys(("ModbusSlaveContext", "ModbusDeviceContext", "Slave"), MAPPING),
    "ModbusServerContext": "Server({unit: device})",
    **dict.fromkeys(("BinaryPayloadDecoder", "BinaryPayloadBuilder", "Endian"), VALUES),
}
"""Name of a class or function -> what is typed here."""


def unknown_name(error: AttributeError, name: str) -> Exception:
    """Return the error for a name that this package lacks, with what is typed in its place."""
    if name in NAMES:
        hint = f"type {NAMES[name]}"
    elif re.fullmatch("modbus_[a-z_]+|MODBUS_[A-Z_]+", name):
        hint = f"TcpContext and RtuContext are libmodbus, and low_level.lib.{name} is that of C"
    else:
        return error
    # "from libmodbus_py import NAME" would hide an AttributeError.
    is_import = "importlib" in sys._getframe(2).f_globals["__name__"]
    return (ImportError if is_import else AttributeError)(f"{error}; {hint}")
