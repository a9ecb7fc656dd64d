"""Scans for units, and searches for their registers: a short path to `tools.scan`."""

from .tools.scan.scan import FoundUnit, Scan, scan
from .tools.scan.search import Extent, Search, search

__all__ = ["Extent", "FoundUnit", "Scan", "Search", "scan", "search"]
