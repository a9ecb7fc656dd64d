"""
SunSpec models of inverters, meters and batteries: a short path to `tools.sunspec`.
"""

from .tools.sunspec.discovery import SunSpecDevice as SunSpecDevice
from .tools.sunspec.discovery import SunSpecError as SunSpecError
from .tools.sunspec.discovery import SunSpecModel as SunSpecModel
from .tools.sunspec.discovery import discover as discover

__all__ = ["SunSpecDevice", "SunSpecError", "SunSpecModel", "discover"]
