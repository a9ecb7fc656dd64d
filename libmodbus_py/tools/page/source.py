"""
The protocols between a page and what it shows: a server, a fleet, a gateway, a watch.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, Protocol

__all__ = ["Action", "Changes", "Download", "PageSource", "PageView"]

Changes = dict[str, Any]
"""The fields of a message, for JSON."""

Action = Callable[[Mapping[str, Any]], object]
"""
Takes the JSON object of a request, and returns that of the response; it raises TypeError,
ValueError or KeyError if the object is wrong or lacks a key.
"""

Download = Callable[[Mapping[str, str]], str]
"""Takes the fields of a query, and returns CSV."""


class PageView(Protocol):
    """The view of one or more pages."""

    def look(self) -> Changes:
        """Return the changes since the last call; everything at the first."""
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
        """Requests of pages, by path; they are called in any thread."""
        ...

    @property
    def downloads(self) -> Mapping[str, Download]:
        """Files that pages offer, by path; they are called in any thread."""
        ...

    def structure(self) -> object:
        """Return what there is to be viewed; another object when that has changed."""
        ...

    def described(self) -> Changes:
        """Return the structure, for a page that does not know it."""
        ...

    def everything(self) -> Changes:
        """Return what all pages show, for a page that missed something."""
        ...

    def changes(self) -> Changes:
        """Return the changes since the last call of what all pages show."""
        ...

    def key(self, given: Mapping[str, Any]) -> Hashable:
        """
        Return the key of the view that a page asks for; equal ones share a view.

        Raises:
            TypeError, ValueError, KeyError: there is no such view.
        """
        ...

    def view(self, key: Any) -> PageView | None:
        """Return a new view; None if what it shows has gone."""
        ...

    def is_current(self, view: Any) -> bool:
        """Return False if a view shows what has gone or was replaced."""
        ...

    def named(self, key: Any) -> Changes:
        """Return the fields by which a page recognizes its view."""
        ...
