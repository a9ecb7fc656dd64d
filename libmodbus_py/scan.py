"""
Units that answer, and the registers that they have: a short path to `tools.scan`.
"""

from .tools.scan.scanning import Found as Found
from .tools.scan.scanning import Scan as Scan
from .tools.scan.scanning import scanning as scan
from .tools.scan.searching import Extent as Extent
from .tools.scan.searching import Search as Search
from .tools.scan.searching import searching as search

scanning = scan  # the former names
searching = search

__all__ = ["Extent", "Found", "Scan", "Search", "scan", "search"]
# Modules of the former folder `scan` are found in `tools.scan`.
__path__: list[str] = []
