"""
Polling of many devices: a short path to `services.fleet`.
"""

from .services.fleet.config import DeviceConfig as DeviceConfig
from .services.fleet.files import FleetFile as FleetFile
from .services.fleet.files import FleetFileError as FleetFileError
from .services.fleet.files import load as load
from .services.fleet.fleet import Fleet as Fleet
from .services.fleet.journal.journal import Journal as Journal
from .services.fleet.journal.journal_reader import HistoricalValue as HistoricalValue
from .services.fleet.journal.schema import JournalError as JournalError
from .services.fleet.readings import Reading as Reading
from .services.fleet.statistics import FleetStatistics as FleetStatistics
from .services.fleet.statistics import JournalStatistics as JournalStatistics
from .services.fleet.statistics import OutputStatistics as OutputStatistics

__all__ = [
    "DeviceConfig",
    "Fleet",
    "FleetFile",
    "FleetFileError",
    "FleetStatistics",
    "HistoricalValue",
    "Journal",
    "JournalError",
    "JournalStatistics",
    "OutputStatistics",
    "Reading",
    "load",
]
