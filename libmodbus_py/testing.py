"""
Serial lines, recording servers and faults, for tests: a short path to `tools.testing`.
"""

from .tools.faults.fault import FaultSwitch as FaultSwitch
from .tools.testing.recording import RecordingServer as RecordingServer
from .tools.testing.recording import ServerMaker as ServerMaker
from .tools.testing.wires import SerialWire as SerialWire
from .tools.testing.wires import TcpWire as TcpWire

__all__ = ["FaultSwitch", "RecordingServer", "SerialWire", "ServerMaker", "TcpWire"]
