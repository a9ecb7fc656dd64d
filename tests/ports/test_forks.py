"""What a forked child does at once with descriptors that its parent has open."""

import os

import pytest

from libmodbus_py.ports.port import abandoned_in_children

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork"),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),
]


class Owner:
    """Counts how often it was abandoned in this process."""

    def __init__(self, error: Exception | None = None) -> None:
        self.times = 0
        self._error = error

    def abandon(self) -> None:
        self.times += 1
        if self._error:
            raise self._error


def times_in_a_child(*owners: Owner) -> list[int]:
    """Return how often a forked child has abandoned each owner."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(write_end, bytes(owner.times for owner in owners))
        os._exit(0)
    os.close(write_end)
    os.waitpid(child, 0)
    with os.fdopen(read_end, "rb") as counts:
        return list(counts.read())


def test_a_child_abandons_each_owner_once_and_the_parent_none() -> None:
    owners = Owner(), Owner()
    for owner in owners:
        abandoned_in_children(owner)
    assert times_in_a_child(*owners) == [1, 1]
    assert [owner.times for owner in owners] == [0, 0]
    assert times_in_a_child(*owners) == [1, 1]


def test_an_owner_that_fails_keeps_no_other_from_it() -> None:
    owners = Owner(), Owner(OSError("fails")), Owner()
    for owner in owners:
        abandoned_in_children(owner)
    assert times_in_a_child(*owners) == [1, 1, 1]
