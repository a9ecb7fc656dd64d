"""
The live page of a running server: a short path to `tools.page`.
"""

from .tools.page.page import Page as Page
from .tools.page.page import live_page as live_page

page_of = live_page  # its former name

__all__ = ["Page", "live_page"]
# Modules of the former folder `page` are found in `tools.page`.
__path__: list[str] = []
