"""
SunSpec models of inverters, meters and batteries: a short path to `tools.sunspec`.
"""

from .tools.sunspec.chain import SunSpecError
from .tools.sunspec.device import SunSpecDevice, SunSpecModel
from .tools.sunspec.discovery import discover

__all__ = ["SunSpecDevice", "SunSpecError", "SunSpecModel", "discover"]
