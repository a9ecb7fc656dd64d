"""Fixtures of the tests of clients."""

from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.clients import KINDS, World, making
from tests.support.transports import TRANSPORTS


@pytest.fixture(params=TRANSPORTS)
def transport(request: pytest.FixtureRequest) -> Any:
    """Each transport of the real system."""
    return request.param


@pytest.fixture(params=KINDS)
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    """Simulated clients of both kinds, and peers."""
    with making(request.param) as world:
        yield world
