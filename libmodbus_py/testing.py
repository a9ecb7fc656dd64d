"""Serial lines, recording servers and faults, for tests: a short path to `tools.testing`."""

from .server.faults import FaultSwitch
from .tools.testing.recording import RecordingServer, ServerMaker
from .tools.testing.wires import SerialWire, TcpWire

__all__ = ["FaultSwitch", "RecordingServer", "SerialWire", "ServerMaker", "TcpWire"]
