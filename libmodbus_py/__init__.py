"""
Modbus for Python on Debian's libmodbus.

Its folders, floor by floor. Imports run downwards only, and those on one floor do not know
each other::

    cli                 libmodbus-py: read, write, scan, listen, serve, gateway, poll, demo
    services            gateway, fleet, workers, engine, integrations
    tools               files, listener, scan, simulator, testing, page, certificates
    client   server     who asks: TcpContext, ..., AsyncClient; who answers: Server
    maps                what stands where in a device, and plans of few requests for it
    ports    device     what carries bytes, and waits for them; one unit and its tables
    binding  security   the C library; who may talk, proven by certificates
    protocol            bytes and values: PDUs, frames, errors; no socket, no clock
    late                public names imported when they are first asked for
    version             a number

What is public comes from there when it is first asked for; ``device_file``, ``errors``,
``framing``, ``low_level``, ``pdu`` and ``values`` are short paths to modules.

A read goes ``client`` -> ``protocol.pdu`` -> ``protocol.framing`` -> ``ports`` -> the wire ->
``ports`` -> ``server`` -> ``device`` -> libmodbus's modbus_reply on the tables, and back. The
docstring of each folder names its files.

Addresses are 0-based and times are in seconds everywhere.
"""

from .late import late, moved
from .version import __version__ as __version__

TYPE_CHECKING = False  # typing, which has it, takes two milliseconds
if TYPE_CHECKING:
    from .binding import low_level
    from .client.asynchronous import AsyncClient
    from .client.blocking import (
        AsciiContext,
        Context,
        RtuContext,
        TcpContext,
        TlsContext,
        UdpContext,
    )
    from .client.reconnecting import State
    from .device.access import Access
    from .device.authorization import Asked
    from .device.device import Caller, Device
    from .device.hooks import Hook
    from .device.mapping import Mapping
    from .device.record_file import RecordFile
    from .device.rules import Allow, Rules
    from .maps.plan import Plan, Read
    from .maps.point import Point
    from .maps.register_map import RegisterMap
    from .ports.trace import Traced
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
    from .security.security import Security
    from .server.faults.fault import Fault
    from .server.limits import Limits
    from .server.server import Running, Server
    from .services.fleet.config import DeviceConfig
    from .services.fleet.fleet import Fleet
    from .services.fleet.readings import Reading
    from .services.gateway.gateway import Gateway
    from .services.gateway.routes import Route
    from .tools.files.maps.drafts import MapError
    from .tools.files.maps.map_file import load_map
    from .tools.listener.capture import CaptureError
    from .tools.listener.listening import Listener, listening
    from .tools.listener.separator import Separator
    from .tools.listener.summary import Summary
    from .tools.listener.transaction import Transaction
    from .tools.page.page import Page, page_of
    from .tools.scan.scanning import Found, Scan, scanning
    from .tools.scan.searching import Extent, Search, searching
    from .tools.simulator import device_file

# fmt: off
__all__ = [
    "Access", "Acknowledge", "Allow", "AsciiContext", "Asked", "AsyncClient", "Caller",
    "CaptureError", "Context", "Device", "DeviceConfig", "ExceptionResponse", "Extent", "Fault",
    "Fleet", "Found", "FrameError", "Gateway", "GatewayPathUnavailable",
    "GatewayTargetFailedToRespond", "Hook", "IllegalDataAddress", "IllegalDataValue",
    "IllegalFunction", "InvalidResponse", "Limits", "Listener", "MapError", "Mapping",
    "MemoryParityError", "ModbusConnectionError", "ModbusError", "ModbusTimeoutError",
    "NegativeAcknowledge", "Page", "Plan", "Point", "Read", "Reading", "RecordFile",
    "RegisterMap", "Route", "RtuContext", "Rules", "Running", "Scan", "Search", "Security",
    "Separator", "Server", "ServerDeviceBusy", "ServerDeviceFailure", "State", "Summary",
    "TcpContext", "TlsContext", "Traced", "Transaction", "UdpContext", "device_file", "errors",
    "framing", "listening", "load_map", "low_level", "page_of", "pdu", "scanning", "searching",
    "values",
]

# Where they are; each is imported when it is first asked for, for a client needs no server.
_HOMES = {
    "client.asynchronous": ("AsyncClient",),
    "client.blocking": (
        "AsciiContext", "Context", "RtuContext", "TcpContext", "TlsContext", "UdpContext",
    ),
    "client.reconnecting": ("State",),
    "device.access": ("Access",),
    "device.authorization": ("Asked",),
    "device.device": ("Caller", "Device"),
    "device.hooks": ("Hook",),
    "device.mapping": ("Mapping",),
    "device.record_file": ("RecordFile",),
    "device.rules": ("Allow", "Rules"),
    "services.fleet.config": ("DeviceConfig",),
    "services.fleet.fleet": ("Fleet",),
    "services.fleet.readings": ("Reading",),
    "services.gateway.gateway": ("Gateway",),
    "services.gateway.routes": ("Route",),
    "tools.listener.capture": ("CaptureError",),
    "tools.listener.listening": ("Listener", "listening"),
    "tools.listener.separator": ("Separator",),
    "tools.listener.summary": ("Summary",),
    "tools.listener.transaction": ("Transaction",),
    "tools.files.maps.drafts": ("MapError",),
    "tools.files.maps.map_file": ("load_map",),
    "maps.plan": ("Plan", "Read"),
    "maps.point": ("Point",),
    "maps.register_map": ("RegisterMap",),
    "tools.page.page": ("Page", "page_of"),
    "ports.trace": ("Traced",),
    "protocol.errors": (
        "Acknowledge", "ExceptionResponse", "FrameError", "GatewayPathUnavailable",
        "GatewayTargetFailedToRespond", "IllegalDataAddress", "IllegalDataValue",
        "IllegalFunction", "InvalidResponse", "MemoryParityError",
        "ModbusConnectionError", "ModbusError", "ModbusTimeoutError",
        "NegativeAcknowledge", "ServerDeviceBusy", "ServerDeviceFailure",
    ),
    "tools.scan.scanning": ("Found", "Scan", "scanning"),
    "tools.scan.searching": ("Extent", "Search", "searching"),
    "security.security": ("Security",),
    "server.faults.fault": ("Fault",),
    "server.limits": ("Limits",),
    "server.server": ("Running", "Server"),
}

# Those that are modules; they have short paths, too: ``from libmodbus_py.pdu import ReadCoils``.
_MODULES = {
    "device_file": "tools.simulator.device_file", "errors": "protocol.errors",
    "framing": "protocol.framing", "low_level": "binding.low_level", "pdu": "protocol.pdu",
    "values": "protocol.values",
}
# fmt: on

# Where modules were before, and programs may still look for them.
_MOVED = {
    "engine": "services.engine",
    "fleet": "services.fleet",
    "gateway": "services.gateway",
    "integrations": "services.integrations",
    "listener": "tools.listener",
    "page": "tools.page",
    "scan": "tools.scan",
    "security.making": "tools.certificates",
    "server.delivery": "server.faults.delivery",
    "simulator": "tools.simulator",
    "testing": "tools.testing",
    "toml": "tools.files",
    "workers": "services.workers",
}

if not TYPE_CHECKING:  # checkers would take any name for one of ours
    __getattr__ = late(__name__, _HOMES, _MODULES)
    moved(__name__, _MOVED)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
