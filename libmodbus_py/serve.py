"""Servers, devices, hooks, rules and audits: a short path to `server` and `device`."""

from .device.access import Access, Caller, ValueChange
from .device.authorization import Allow, ClientRequest, Rules
from .device.device import Device
from .device.hooks import Hook
from .device.mapping import Mapping
from .device.records import FifoQueue, RecordFile
from .server.audit import Audit, AuditEvent, AuditFile
from .server.limits import Limits, ServerStatistics
from .server.server import Server
from .server.serving import Running
from .tools.faults.fault import Fault

__all__ = [
    "Access",
    "Allow",
    "Audit",
    "AuditEvent",
    "AuditFile",
    "Caller",
    "ClientRequest",
    "Device",
    "Fault",
    "FifoQueue",
    "Hook",
    "Limits",
    "Mapping",
    "RecordFile",
    "Rules",
    "Running",
    "Server",
    "ServerStatistics",
    "ValueChange",
]  # fmt: skip
