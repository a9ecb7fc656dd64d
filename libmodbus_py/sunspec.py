"""SunSpec models of inverters, meters and batteries: a short path to `tools.sunspec`."""

from .tools.sunspec import SunSpecDevice, SunSpecError, SunSpecModel, discover

__all__ = ["SunSpecDevice", "SunSpecError", "SunSpecModel", "discover"]
