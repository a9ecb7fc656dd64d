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

READ_VALUE = 'read_value("holding_registers", address, "float32")'
WRITE_VALUE = 'write_value("holding_registers", address, value, "float32")'
READ_WRITE = "read_write_registers(read_address, read_count, write_address, values)"
UNIT = "unit; unit=17 is an argument of the class"

ATTRIBUTES = {
    "read_registers": "read_holding_registers(address, count)",
    "read_register": "read_holding_registers(address, 1)",
    "read_bits": "read_coils(address, count)",
    "read_bit": "read_coils(address, 1)",
    "read_input_bits": "read_discrete_inputs(address, count)",
    **dict.fromkeys(("write_bit", "write_single_coil"), "write_coil(address, value)"),
    **dict.fromkeys(("write_bits", "write_multiple_coils"), "write_coils(address, values)"),
    "write_single_register": "write_register(address, value)",
    "write_multiple_registers": "write_registers(address, values)",
    **dict.fromkeys(("readwrite_registers", "write_and_read_registers"), READ_WRITE),
    "report_slave_id": "report_server_id()",
    "read_device_information": "read_device_identification()",
    **dict.fromkeys(("read_float", "read_long", "read_string"), READ_VALUE),
    **dict.fromkeys(("write_float", "write_long", "write_string"), WRITE_VALUE),
    "convert_from_registers": READ_VALUE,
    "convert_to_registers": WRITE_VALUE,
    **dict.fromkeys(("set_slave", "get_slave", "slave", "unit_id", "device_id"), UNIT),
    **dict.fromkeys(("connected", "is_open", "is_socket_open"), "state is State.CONNECTED"),
    "open": "connect()",
    **dict.fromkeys(("set_response_timeout", "get_response_timeout"), "response_timeout"),
    **dict.fromkeys(("set_byte_timeout", "get_byte_timeout"), "byte_timeout"),
    "set_error_recovery": "error_recovery",
    "set_debug": "debug",
    "get_socket": "socket",
    **dict.fromkeys(("serve", "listen", "run"), "serve_forever(url)"),
    **dict.fromkeys(
        ("start", "stop", "shutdown"), "background(url) behind with, whose end stops it"
    ),
}
"""Name of an attribute -> what is typed here, if the class has the first word of it."""


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


def attribute_here(kind: type, name: str) -> str:
    """Return the end of a message about an attribute that a class lacks; "" if none is meant."""
    known = name.removeprefix("modbus_")
    text = known if hasattr(kind, known) else ATTRIBUTES.get(known, "")
    first = re.match(r"\w*", text)
    return f"; type {text}" if first and hasattr(kind, first[0]) else ""
