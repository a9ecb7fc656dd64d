"""The network that scans meet, in simulated time."""

from collections.abc import Iterator

import pytest

from tests.simulation.network import Network
from tests.tools.scan.simulated_bus import simulated


@pytest.fixture
def network() -> Iterator[Network]:
    """A network in memory for all clients that a test makes."""
    with simulated() as hosts:
        yield hosts
