"""
Servers of the command line, for the tests of other commands.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from tests.support.commands import Started


@contextmanager
def serving(*urls: str) -> Iterator[list[str]]:
    with Started("serve", *urls) as process:
        lines = [process.stdout.readline() for _ in urls]
        yield [line.removeprefix("listening on ").rstrip("\n") for line in lines]
        process.terminate()
        assert process.wait() == 0
