"""
Scans for units, and searches for their registers: a short path to `tools.scan`.
"""

from .tools.scan.scan import Found as Found
from .tools.scan.scan import Scan as Scan
from .tools.scan.scan import scan as scan
from .tools.scan.search import Extent as Extent
from .tools.scan.search import Search as Search
from .tools.scan.search import search as search

__all__ = ["Extent", "Found", "Scan", "Search", "scan", "search"]
