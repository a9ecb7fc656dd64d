"""
What the tests of clients share.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.clients import World, making


@pytest.fixture(params=["python", "asyncio"])
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    """Simulated clients of both kinds, and peers; with `EVERYWHERE` a real one that C carries."""
    with making(request.param) as made:
        yield made
