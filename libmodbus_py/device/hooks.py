"""
Functions of the application that a device calls: the accesses they are for, and their duration.
"""

from __future__ import annotations

import reprlib
import time
from collections.abc import Callable, Iterable
from copy import copy
from typing import TypeAlias, TypeVar

from ..protocol.checks import checked_callback, finished
from ..protocol.logs import HarmlessLogger
from ..protocol.mistakes import named_arguments
from ..protocol.tables import TABLE_SIZE, checked_ranges, joined, touches
from .access import READABLE, Access, Accesses

logger: HarmlessLogger = HarmlessLogger(__name__)

SLOW = 0.1
"""Seconds after which a function of the application is slow: no client is answered meanwhile."""

Given = TypeVar("Given")
Result = TypeVar("Result")

Addresses: TypeAlias = range | Iterable[range]

EVERYTHING = (range(TABLE_SIZE),)

# `Access.table` -> the argument of `Hook`, where they differ.
NAMES = {"file": "files", "fifo": "fifos"}


@named_arguments
class Hook:
    """
    A function that is only called for accesses to certain addresses.

    The server answers all other requests as if there were no hook, in C for Modbus/TCP. If an
    access touches one of the addresses, the function gets the whole access. Without any addresses,
    the function is called for every access, as it would be without a `Hook`.

    Args:
        call: the function, which is called with an `Access`.
        coils, discrete_inputs, holding_registers, input_registers: addresses in this table,
            0..65535: a range, or a list of ranges. ``range(65536)`` is the whole table.
        files: file numbers, 0..65535: a range, or a list of ranges.
        fifos: pointer addresses of FIFO queues, 0..65535: a range, or a list of ranges.

    Attributes:
        call: the function.
        places: ``{Access.table: ranges}``, in ascending order and without overlaps; for "file",
            ranges of file numbers. None if the hook is called for every access.

    Raises:
        TypeError, ValueError: an argument is wrong.
    """

    def __init__(
        self,
        call: Callable[[Access], object],
        *,
        coils: Addresses | None = None,
        discrete_inputs: Addresses | None = None,
        holding_registers: Addresses | None = None,
        input_registers: Addresses | None = None,
        files: Addresses | None = None,
        fifos: Addresses | None = None,
    ) -> None:
        checked_callback("call", call)
        self._call: Callable[[Access], object] = call
        tables = coils, discrete_inputs, holding_registers, input_registers, fifos, files
        places = {
            table: joined(checked_ranges(NAMES.get(table, table), addresses))
            for table, addresses in zip(READABLE, tables, strict=True)
            if addresses is not None
        }
        self._places: dict[str, tuple[range, ...]] | None = places or None

    @property
    def call(self) -> Callable[[Access], object]:
        """The function."""
        return self._call

    @property
    def places(self) -> dict[str, tuple[range, ...]] | None:
        """The ranges by table; None if the hook is called for every access."""
        return self._places

    def __repr__(self) -> str:
        return f"Hook({self.call!r}, places={self.places})"

    def in_table(self, table: str) -> tuple[range, ...]:
        """Return the addresses of a table for which the hook is called."""
        return EVERYTHING if self.places is None else self.places.get(table, ())

    def wants(self, access: Access) -> bool:
        """Return True if the hook is called for an access."""
        is_file = access.table == "file"
        first, count = (access.file, 1) if is_file else (access.address, access.count)
        return touches(self.in_table(access.table), first, count)


HookLike: TypeAlias = Hook | Callable[[Access], object]


class Hooks:
    """
    The hooks of a device; `reads` and `writes`: the addresses that one wants, by table.

    The `refresh` of a simulated device is called before `before_read`.
    """

    def __init__(
        self,
        before_write: HookLike | None,
        after_write: HookLike | None,
        before_read: HookLike | None,
        refresh: Hook | None,
    ) -> None:
        self._refresh = refresh
        self._before_write = _hook("before_write", before_write)
        self._after_write = _hook("after_write", after_write)
        self._before_read = _hook("before_read", before_read)
        self.reads: dict[str, tuple[range, ...]] = _places(refresh, self._before_read)
        self.writes: dict[str, tuple[range, ...]] = _places(self._before_write, self._after_write)
        self.is_empty: bool = before_write is after_write is before_read is refresh is None

    def before(self, accesses: Accesses) -> None:
        """Call the hooks that may refuse accesses."""
        _call(self._before_write, accesses.writes)
        _call(self._refresh, accesses.reads)
        _call(self._before_read, accesses.reads)

    def after(self, accesses: Accesses) -> None:
        _call(self._after_write, accesses.writes)


def _hook(name: str, hook: HookLike | None) -> Hook | None:
    """Return a hook whose calls are measured; that of the user may belong to several devices."""
    if hook is None:
        return None
    if not isinstance(hook, Hook) and not callable(hook):
        raise TypeError(f"{name} must be a function or a Hook, not {reprlib.repr(hook)}")
    own = copy(hook) if isinstance(hook, Hook) else Hook(checked_callback(name, hook))
    own._call = timed(name, own.call)
    return own


def _call(hook: Hook | None, accesses: tuple[Access, ...]) -> None:
    if hook is not None:
        for access in accesses:
            if hook.places is None or hook.wants(access):
                hook.call(access)


def _places(*hooks: Hook | None) -> dict[str, tuple[range, ...]]:
    present = [hook for hook in hooks if hook is not None]
    return {
        table: joined(run for hook in present for run in hook.in_table(table)) for table in READABLE
    }


def timed(name: str, call: Callable[[Given], Result]) -> Callable[[Given], Result]:
    """
    Return a function that calls one of the application, and logs once if it took long.

    No function, or one with ``async def``, is a TypeError, here or when a coroutine is returned.
    """
    checked_callback(name, call)
    is_known = False

    def measured(argument: Given) -> Result:
        nonlocal is_known
        start = time.monotonic()
        try:
            result = call(argument)
            return result if result is None else finished(name, result)
        finally:  # a failed call may have taken long, too
            took = time.monotonic() - start
            if took >= SLOW and not is_known:
                is_known = True
                own_name = getattr(call, "__qualname__", None) or repr(call)
                text = "%s (%s) took %.3g s, and held up all clients of the server meanwhile; "
                logger.warning(text + "this is logged once", name, own_name, took)

    return measured
