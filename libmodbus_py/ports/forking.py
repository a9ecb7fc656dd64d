"""
A forked child closes its copies of the descriptors of clients and servers.

While a child holds a copy, no peer sees the end of a connection that the parent closes, and no
port is free again.
"""

from __future__ import annotations

import contextlib
import weakref
from typing import Protocol

from ..system import call_in_children

__all__ = ["abandoned_in_children"]


class Holder(Protocol):
    """An object that holds descriptors, such as a server or the driver of a client."""

    def abandon(self) -> None:
        """
        In a forked child: close the descriptors, and forget what the parent goes on with.

        This changes neither loops and epolls, nor lines and their locks: the parent
        shares them.
        """
        ...


_holders: weakref.WeakSet[Holder] = weakref.WeakSet()


def abandoned_in_children(holder: Holder) -> None:
    """Call `abandon` of an object in every child that is forked while it exists."""
    _holders.add(holder)


def _abandon_all() -> None:
    for holder in list(_holders):
        # Not logged: another thread of the parent may have held the locks of the log.
        with contextlib.suppress(Exception):
            holder.abandon()


call_in_children(_abandon_all)
