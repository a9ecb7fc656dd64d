"""
Servers, devices, hooks, rules and audits: a short path to `server` and `device`.
"""

from .device.access import Access as Access
from .device.authorization import Asked as Asked
from .device.caller import Caller as Caller
from .device.caller import ValueChange as ValueChange
from .device.device import Device as Device
from .device.functions import RecordFile as RecordFile
from .device.hooks import Hook as Hook
from .device.mapping import Mapping as Mapping
from .device.rules import Allow as Allow
from .device.rules import Rules as Rules
from .server.audit import Audit as Audit
from .server.audit import AuditEvent as AuditEvent
from .server.audit import AuditFile as AuditFile
from .server.limits import Limits as Limits
from .server.limits import ServerStatistics as ServerStatistics
from .server.server import Running as Running
from .tools.faults.fault import Fault as Fault
from .tools.faults.server import Server as Server

__all__ = [
    "Access",
    "Allow",
    "Asked",
    "Audit",
    "AuditEvent",
    "AuditFile",
    "Caller",
    "Device",
    "Fault",
    "Hook",
    "Limits",
    "Mapping",
    "RecordFile",
    "Rules",
    "Running",
    "Server",
    "ServerStatistics",
    "ValueChange",
]
