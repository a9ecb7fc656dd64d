"""
Modbus for Python on Debian's libmodbus.

The way of one request, file by file, which is also the order to read them in::

    context     TcpContext, RtuContext, AsciiContext: the blocking client
    line        one transaction at a time, through libmodbus (native) or without
    pdu         one class for each function: encode and decode, both ends
    framing     unit and PDU as bytes on TCP, RTU and ASCII lines
    link        a descriptor in a modbus_t: tcp_link a connection, serial_link a port
      ... the wire ...
    server      Server: many clients, many endpoints
    units       which device answers a frame, on TCP and on serial lines
    device      Device: request PDU in, response PDU out; beside it access (what hooks
                see), communication (counters and log of a line), record_file
    engine      libmodbus's modbus_reply, in memory
    mapping     Mapping: four tables, which it answers from

Around them: errors (the exceptions), arguments (the check of numbers), url (endpoints),
values (numbers and text in registers, references such as 40123), _c and low_level
(libmodbus), cli and demo, device_file with behaviour and faults (the simulator), tap.

Addresses are 0-based and times are in seconds everywhere.
"""

from . import framing, pdu, values
from .access import Access
from .context import AsciiContext, Context, RtuContext, TcpContext
from .device import Caller, Device
from .errors import (
    Acknowledge,
    ExceptionResponse,
    FrameError,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    InvalidResponse,
    MemoryParityError,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    NegativeAcknowledge,
    ServerDeviceBusy,
    ServerDeviceFailure,
)
from .faults import Fault
from .mapping import Mapping
from .record_file import RecordFile
from .server import Running, Server

__all__ = [
    "Access",
    "Acknowledge",
    "AsciiContext",
    "Caller",
    "Context",
    "Device",
    "ExceptionResponse",
    "Fault",
    "FrameError",
    "GatewayPathUnavailable",
    "GatewayTargetFailedToRespond",
    "IllegalDataAddress",
    "IllegalDataValue",
    "IllegalFunction",
    "InvalidResponse",
    "Mapping",
    "MemoryParityError",
    "ModbusConnectionError",
    "ModbusError",
    "ModbusTimeoutError",
    "NegativeAcknowledge",
    "RecordFile",
    "RtuContext",
    "Running",
    "Server",
    "ServerDeviceBusy",
    "ServerDeviceFailure",
    "TcpContext",
    "framing",
    "pdu",
    "values",
]

__version__ = "0.1.0"
