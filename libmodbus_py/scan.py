"""Scans for units, and searches for their registers: a short path to `tools.scan`."""

from .tools.scan.scan import Found, Scan, scan
from .tools.scan.search import Extent, Search, search

__all__ = ["Extent", "Found", "Scan", "Search", "scan", "search"]
