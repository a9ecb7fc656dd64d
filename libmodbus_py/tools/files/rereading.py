"""
A file that is read again while a program uses its former content.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

__all__ = ["reread"]

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
