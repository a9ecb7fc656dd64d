"""
The fault switch of a server, under the name that tests import.
"""

from ..faults.switch import FaultSwitch, Switched

__all__ = ["FaultSwitch", "Switched"]
