"""
A file that is read again while a program uses its former content.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

__all__ = ["compared", "reread"]

Content = TypeVar("Content")


def reread(
    load: Callable[[], Content],
    use: Callable[[Content], Iterable[str]],
    tell: Callable[[str], object],
) -> None:
    """
    Load a file again and use its content; a mistake in the file changes nothing.

    Args:
        load: returns the content, or raises TypeError or ValueError with the mistake.
        use: applies the content and returns what changed, in lines; raises TypeError or
            ValueError, before it changes anything, if the content cannot be used.
        tell: called with each line, or with the mistake.
    """
    try:
        lines = use(load())
    except (TypeError, ValueError) as error:
        lines = [f"nothing is changed: {error}"]
    for line in lines:
        tell(line)


def compared(path: str, noun: str, before: Mapping[Any, Any], after: Mapping[Any, Any]) -> str:
    """
    Return a line about what changed in a file that was read again.

    Args:
        path: of the file.
        noun: what the file describes, such as "device".
        before, after: these things, by their names or numbers.
    """
    both = before.keys() & after.keys()
    counts = {
        "new": len(after.keys() - both),
        "changed": sum(before[key] != after[key] for key in both),
        "removed": len(before.keys() - both),
    }
    changes = ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    plural = "s" * (len(after) != 1)
    return f"{path}: read again, {len(after)} {noun}{plural}: {changes or 'no change'}"
