"""
A server of the command line, for the tests of other commands.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.cli.serving import serving


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serving("tcp://127.0.0.1:0") as urls:
        yield urls[0]
