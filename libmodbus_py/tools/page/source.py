"""
The protocols between a page and the things that it shows: a server, a fleet, a gateway, a watch.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, Protocol

__all__ = ["Action", "Changes", "Download", "PageSource", "PageView"]

Changes = dict[str, Any]
"""The fields of a message, for JSON."""

Action = Callable[[Mapping[str, Any]], object]
"""
Takes the JSON object of a request, and returns the JSON object of the response. Raises TypeError,
ValueError or KeyError if the object is wrong or lacks a key.
"""

Download = Callable[[Mapping[str, str]], str]
"""Takes the fields of a query, and returns CSV."""


class PageView(Protocol):
    """The view of one or more pages."""

    def look(self) -> Changes:
        """Return the changes since the last call; everything on the first call."""
        ...

    def all(self) -> Changes:
        """Return everything as of the last `look`."""
        ...


class PageSource(Protocol):
    """
    The things that all open pages of one address show; a thread of the page calls the methods.
    """

    @property
    def document(self) -> str:
        """The HTML file in this folder."""
        ...

    @property
    def actions(self) -> Mapping[str, Action]:
        """The functions that answer requests of pages, by path; called in any thread."""
        ...

    @property
    def downloads(self) -> Mapping[str, Download]:
        """The functions that make files to download, by path; called in any thread."""
        ...

    def structure(self) -> object:
        """Return the structure of what can be viewed; a new object if it has changed."""
        ...

    def described(self) -> Changes:
        """Return the structure, for a page that has not received it."""
        ...

    def everything(self) -> Changes:
        """Return the parts that all pages show, for a page that missed a change of them."""
        ...

    def changes(self) -> Changes:
        """Return the changes since the last call in the parts that all pages show."""
        ...

    def key(self, given: Mapping[str, Any]) -> Hashable:
        """
        Return the key of the view that a page requests; pages with equal keys share a view.

        Raises:
            TypeError, ValueError, KeyError: there is no such view.
        """
        ...

    def view(self, key: Any) -> PageView | None:
        """Return a new view; None if the unit or table that it shows no longer exists."""
        ...

    def is_current(self, view: Any) -> bool:
        """Return False if the unit or table of a view no longer exists or was replaced."""
        ...

    def named(self, key: Any) -> Changes:
        """Return the fields by which a page recognizes its view."""
        ...
