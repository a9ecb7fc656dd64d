"""The live page of a running server: a short path to `tools.page`."""

from .tools.page.page import Page, live_page

__all__ = ["Page", "live_page"]
