"""
Servers of the command line, and a fleet file, for the tests of other commands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from tests.support.commands import Started

FLEET_OF_ONE = """
[[device]]
name = "one"
url = "{url}"
[[device.point]]
name = "volts"
table = "holding_registers"
address = 0
"""
"""A fleet file with one point of the device at a URL, which `format` sets."""


@contextmanager
def serving(*urls: str, options: Sequence[str] = ()) -> Iterator[list[str]]:
    with Started("serve", *urls, *options) as process:
        lines = [process.stdout.readline() for _ in urls]
        yield [line.removeprefix("listening on ").rstrip("\n") for line in lines]
        process.terminate()
        assert process.wait() == 0
