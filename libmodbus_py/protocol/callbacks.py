"""
Functions that users pass to the package: which are refused, and what is logged when one fails.

The package calls them at once, and awaits nothing. The body of ``async def`` would never run, so
that a hook refused nothing, and a guard that returned a coroutine, which is true, allowed all.
"""

from __future__ import annotations

from functools import partial
from types import AsyncGeneratorType, CoroutineType, GeneratorType
from typing import TYPE_CHECKING, Any, TypeVar

from .mistakes import Path, WrongType

if TYPE_CHECKING:
    from .logs import HarmlessLogger

__all__ = ["checked_callback", "finished", "log_failure", "log_warning"]

Given = TypeVar("Given")
Result = TypeVar("Result")

UNSTARTED = (CoroutineType, GeneratorType, AsyncGeneratorType)
"""The types of results that stand for a body of which nothing has run."""

# Of code: a generator, a coroutine, one made of a generator, an asynchronous generator (inspect).
NOT_AT_ONCE = 0x20 | 0x80 | 0x100 | 0x200


def checked_callback(name: str | Path, given: Given) -> Given:
    """
    Return a function of a user as it is.

    Args:
        name: of the argument, for messages.

    Raises:
        TypeError: it is not callable; or its body does not run when it is called (``async def``,
            ``yield``), also as a method, in a `functools.partial`, or as ``__call__``.
    """
    if not callable(given):
        raise WrongType(name, f"must be a function, not {type(given).__name__}")
    if _is_delayed(given):
        raise WrongType(name, "must be a plain function, because nothing awaits async def")
    return given


def _is_delayed(given: Any) -> bool:
    while isinstance(given, partial):
        given = given.func
    code = getattr(given, "__code__", None)
    if code is None:  # an object with __call__; a method has the code of its function
        code = getattr(type(given).__call__, "__code__", None)
    flags = getattr(code, "co_flags", 0)
    return isinstance(flags, int) and bool(flags & NOT_AT_ONCE)


def finished(name: str, result: Result) -> Result:
    """
    Return the result of a function of a user.

    Raises:
        TypeError: it is a coroutine or a generator: nothing was done yet. It is closed.
    """
    if isinstance(result, UNSTARTED):
        if not isinstance(result, AsyncGeneratorType):
            result.close()
        raise TypeError(f"{name} returned a {type(result).__name__}, which nothing awaits")
    return result


def log_failure(logger: str, text: str, *args: object) -> None:
    """
    Log the exception that is being handled; one that a log handler raises goes to stderr.

    Args:
        logger: the name of the logger.
        text, args: as for `logging.Logger.exception`.
    """
    found = _logger(logger)
    if found is not None:
        found.exception(text, *args, stacklevel=2)


def log_warning(logger: str, text: str, *args: object) -> None:
    """Log a warning; for the arguments see `log_failure`."""
    found = _logger(logger)
    if found is not None:
        found.warning(text, *args, stacklevel=2)


def _logger(name: str) -> HarmlessLogger | None:
    """Return a logger; None if logging cannot be imported, because no descriptor is left."""
    try:
        from .logs import HarmlessLogger  # no sooner than needed: most programs log nothing
    except OSError:
        return None
    return HarmlessLogger(name)
