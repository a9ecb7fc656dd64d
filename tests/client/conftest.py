"""
For tests that hold for both clients, and both ways of the blocking one.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from clients import KINDS, Connect, connecting


@pytest.fixture(params=KINDS)
def connect(request: pytest.FixtureRequest) -> Iterator[Connect]:
    """Makes clients of one kind for a URL."""
    with connecting(request.param) as made:
        yield made
