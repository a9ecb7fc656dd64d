"""Polling of many devices: a short path to `services.fleet`."""

from .services.fleet.config import DeviceConfig
from .services.fleet.files import FleetFile, FleetFileError, load
from .services.fleet.fleet import Fleet
from .services.fleet.journal.journal import Journal
from .services.fleet.journal.journal_reader import HistoricalValue
from .services.fleet.journal.schema import JournalError
from .services.fleet.outputs.output import Output, OutputError, ReadingsRefused
from .services.fleet.readings import Reading
from .services.fleet.statistics import FleetStatistics, JournalStatistics, OutputStatistics

__all__ = [
    "DeviceConfig", "Fleet", "FleetFile", "FleetFileError", "FleetStatistics", "HistoricalValue",
    "Journal", "JournalError", "JournalStatistics", "Output", "OutputError", "OutputStatistics",
    "Reading", "ReadingsRefused", "load",
]  # fmt: skip
