"""
Modbus for Python on Debian's libmodbus.

The way of one request, file by file, which is also the order to read them in::

    context     TcpContext, UdpContext, RtuContext, AsciiContext: the blocking clients
    line        one transaction at a time, through libmodbus (native) or without; many
                in flight: pipeline
    client      AsyncClient, the same for asyncio; behind it channel (who may send when),
                flight (which answer is whose; alternating on serial lines), connection
                (its life) and transport (its descriptor) in place of line and link
    pdu         one class for each function: encode and decode, both ends
    framing     unit and PDU as bytes on TCP, UDP, RTU and ASCII lines
    link        a descriptor in a modbus_t: serial_link a port, socket_link a TCP
                connection (tcp_link) or a UDP socket (udp_link)
      ... the wire ...
    server      Server: many clients, many endpoints (tcp_server, udp_server, serial_server;
                listening makes sockets)
    clients     the TCP connections of a server, within its limits
    session     bytes in, answers out; chunk_session on TCP, by the chunk and in C
    units       which device answers a frame, on TCP and on serial lines
    device      Device: request PDU in, response PDU out; beside it access (what hooks
                see), communication (counters and log of a line), record_file
    engine      libmodbus's modbus_reply, in memory (_chunk.c)
    mapping     Mapping: four tables, which it answers from

Around them: errors (the exceptions), arguments (the check of numbers), url (endpoints),
values (numbers and text in registers, references such as 40123), plan (many reads in few
requests), _c and low_level (libmodbus), cli and demo, device_file with behaviour and faults
(the simulator), tap.

Addresses are 0-based and times are in seconds everywhere.
"""

import sys

from .binding import low_level
from .client.asynchronous import AsyncClient, State
from .client.blocking import AsciiContext, Context, RtuContext, TcpContext, UdpContext
from .client.plan import Plan, Read
from .device.access import Access
from .device.device import Caller, Device
from .device.mapping import Mapping
from .device.record_file import RecordFile
from .protocol import errors, framing, pdu, values
from .protocol.errors import (
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
from .server.faults import Fault
from .server.limits import Limits
from .server.server import Running, Server
from .simulator import device_file

__all__ = [
    "Access",
    "Acknowledge",
    "AsciiContext",
    "AsyncClient",
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
    "Limits",
    "Mapping",
    "MemoryParityError",
    "ModbusConnectionError",
    "ModbusError",
    "ModbusTimeoutError",
    "NegativeAcknowledge",
    "Plan",
    "Read",
    "RecordFile",
    "RtuContext",
    "Running",
    "Server",
    "ServerDeviceBusy",
    "ServerDeviceFailure",
    "State",
    "TcpContext",
    "UdpContext",
    "device_file",
    "errors",
    "framing",
    "low_level",
    "pdu",
    "values",
]

__version__ = "0.1.0"

# The short paths of what programs import by name: ``from libmodbus_py.pdu import ReadCoils``.
for _module in (device_file, errors, framing, low_level, pdu, values):
    sys.modules[f"{__name__}.{_module.__name__.rpartition('.')[2]}"] = _module
