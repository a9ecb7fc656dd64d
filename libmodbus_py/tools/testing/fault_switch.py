"""
The fault switch of a server, under the path that tests import it from.
"""

from ...server.faults.switch import FaultSwitch, Switched

__all__ = ["FaultSwitch", "Switched"]
