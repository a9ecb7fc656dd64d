"""
Modbus for Python on Debian's libmodbus.

Its folders, floor by floor. Imports run downwards only, and those on one floor do not know
each other::

    cli                 libmodbus-py: read, write, scan, listen, serve, gateway, demo, certificates
    integrations        metrics for Prometheus
    gateway             requests passed on from any endpoint to any line
    simulator           devices from a file, which move, wait and err
    testing             lines with a tap, for tests and the demo
    scan                who answers on a line or network, and what they have
    client   server     who asks: TcpContext, ..., AsyncClient; who answers: Server;
    listener            and who only listens: transactions of others on a line
    toml                what files in TOML have in common
    ports    device     what carries bytes, and waits for them; one unit and its tables
    binding  security   the C library; who may talk, proven by certificates
    protocol            bytes and values: PDUs, frames, errors; no socket, no clock

A read goes ``client`` -> ``protocol.pdu`` -> ``protocol.framing`` -> ``ports`` -> the wire ->
``ports`` -> ``server`` -> ``device`` -> libmodbus's modbus_reply on the tables, and back. The
docstring of each folder names its files.

Addresses are 0-based and times are in seconds everywhere.
"""

import sys

from .binding import low_level
from .client.asynchronous import AsyncClient
from .client.blocking import AsciiContext, Context, RtuContext, TcpContext, TlsContext, UdpContext
from .client.plan import Plan, Read
from .client.reconnecting import State
from .client.trace import Traced
from .device.access import Access
from .device.authorization import Asked
from .device.device import Caller, Device
from .device.hooks import Hook
from .device.mapping import Mapping
from .device.record_file import RecordFile
from .device.rules import Allow, Rules
from .gateway.gateway import Gateway
from .gateway.routes import Route
from .listener.capture import CaptureError
from .listener.listening import Listener, listening
from .listener.separator import Separator
from .listener.summary import Summary
from .listener.transaction import Transaction
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
from .scan.scanning import Found, Scan, scanning
from .scan.searching import Extent, Search, searching
from .security.security import Security
from .server.faults import Fault
from .server.limits import Limits
from .server.server import Running, Server
from .simulator import device_file

# fmt: off
__all__ = [
    "Access", "Acknowledge", "Allow", "AsciiContext", "Asked", "AsyncClient", "Caller",
    "CaptureError", "Context", "Device", "ExceptionResponse", "Extent", "Fault", "Found",
    "FrameError", "Gateway", "GatewayPathUnavailable", "GatewayTargetFailedToRespond", "Hook",
    "IllegalDataAddress", "IllegalDataValue", "IllegalFunction", "InvalidResponse", "Limits",
    "Listener", "Mapping", "MemoryParityError", "ModbusConnectionError", "ModbusError",
    "ModbusTimeoutError", "NegativeAcknowledge", "Plan", "Read", "RecordFile", "Route",
    "RtuContext", "Rules", "Running", "Scan", "Search", "Security", "Separator", "Server",
    "ServerDeviceBusy", "ServerDeviceFailure", "State", "Summary", "TcpContext", "TlsContext",
    "Traced", "Transaction", "UdpContext", "device_file", "errors", "framing", "listening",
    "low_level", "pdu", "scanning", "searching", "values",
]
# fmt: on

__version__ = "0.1.0"

# The short paths of what programs import by name: ``from libmodbus_py.pdu import ReadCoils``.
for _module in (device_file, errors, framing, low_level, pdu, values):
    sys.modules[f"{__name__}.{_module.__name__.rpartition('.')[2]}"] = _module
