"""
The public names of the package, each once: type checkers read this file, and so does Python.
"""

from .binding import low_level as low_level
from .client.asynchronous import AsyncClient as AsyncClient
from .client.blocking import AsciiContext as AsciiContext
from .client.blocking import Client as Client
from .client.blocking import Context as Context
from .client.blocking import RtuContext as RtuContext
from .client.blocking import TcpContext as TcpContext
from .client.blocking import TlsContext as TlsContext
from .client.blocking import UdpContext as UdpContext
from .client.reconnecting import State as State
from .client.statistics import Statistics as Statistics
from .device.access import Access as Access
from .device.device import Device as Device
from .device.hooks import Hook as Hook
from .device.mapping import Mapping as Mapping
from .device.rules import Allow as Allow
from .device.rules import Rules as Rules
from .maps.holes import Unreadable as Unreadable
from .maps.meaning import NoValue as NoValue
from .maps.plan import Plan as Plan
from .maps.plan import Read as Read
from .maps.point import Point as Point
from .maps.register_map import RegisterMap as RegisterMap
from .ports.trace import Traced as Traced
from .protocol import errors as errors
from .protocol import framing as framing
from .protocol import pdu as pdu
from .protocol import values as values
from .protocol.errors import Acknowledge as Acknowledge
from .protocol.errors import ExceptionResponse as ExceptionResponse
from .protocol.errors import FrameError as FrameError
from .protocol.errors import GatewayPathUnavailable as GatewayPathUnavailable
from .protocol.errors import GatewayTargetFailedToRespond as GatewayTargetFailedToRespond
from .protocol.errors import IllegalDataAddress as IllegalDataAddress
from .protocol.errors import IllegalDataValue as IllegalDataValue
from .protocol.errors import IllegalFunction as IllegalFunction
from .protocol.errors import InvalidResponse as InvalidResponse
from .protocol.errors import MemoryParityError as MemoryParityError
from .protocol.errors import ModbusConnectionError as ModbusConnectionError
from .protocol.errors import ModbusError as ModbusError
from .protocol.errors import ModbusTimeoutError as ModbusTimeoutError
from .protocol.errors import NegativeAcknowledge as NegativeAcknowledge
from .protocol.errors import ServerDeviceBusy as ServerDeviceBusy
from .protocol.errors import ServerDeviceFailure as ServerDeviceFailure
from .security.security import Security as Security
from .server.limits import Limits as Limits
from .server.limits import ServerStatistics as ServerStatistics
from .services.fleet.config import DeviceConfig as DeviceConfig
from .services.fleet.fleet import Fleet as Fleet
from .services.gateway.gateway import Gateway as Gateway
from .services.gateway.routes import Route as Route
from .services.loading import load as load
from .tools.faults.fault import Fault as Fault
from .tools.faults.server import Server as Server
from .tools.files.maps.drafts import MapError as MapError
from .tools.files.maps.map_file import load_map as load_map
from .tools.simulator import device_file as device_file
from .version import __version__ as __version__

# isort: split
# Former names; using one emits a DeprecationWarning.

from .fleet import Reading as Reading
from .listen import CaptureError as CaptureError
from .listen import Listener as Listener
from .listen import Separator as Separator
from .listen import Summary as Summary
from .listen import Transaction as Transaction
from .listen import listening as listening
from .page import Page as Page
from .page import page_of as page_of
from .scan import Extent as Extent
from .scan import Found as Found
from .scan import Scan as Scan
from .scan import Search as Search
from .scan import scanning as scanning
from .scan import searching as searching
from .serve import Asked as Asked
from .serve import Caller as Caller
from .serve import RecordFile as RecordFile
from .serve import Running as Running
