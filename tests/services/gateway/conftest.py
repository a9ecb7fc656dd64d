"""
What the tests of gateways share.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.simulation.stage import Stage


@pytest.fixture
def stage() -> Iterator[Stage]:
    """A network in memory, on which seconds pass only while the test waits."""
    with Stage() as made:
        yield made
