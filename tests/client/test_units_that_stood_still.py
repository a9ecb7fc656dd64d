"""
A unit that stood still, and then responds to all requests that it received, in their order.

Nothing in RTU tells its first response from that to the present request: how long this lasts.
"""

from __future__ import annotations

import pytest

from tests.client.test_doubled_answers import warm
from tests.support.talk import value


@pytest.mark.parametrize("pause", [0.02, 0.5])
def test_values_are_right_again_after_a_pause(pause: float) -> None:
    """Longer than a response takes, which is 10 ms."""
    talk = warm()
    lost = talk.ask(100)
    talk.wait(1)
    assert lost.is_done
    present = talk.ask(101)
    talk.wait(1)  # the line must be silent
    talk.wait(0.01)
    talk.come(value(100))
    assert present.outcomes == [[100]]
    talk.wait(0.01)
    talk.come(value(101))  # nobody asked for it any more
    for address in range(102, 110):
        talk.wait(pause)
        batch = talk.ask(address)
        talk.wait(0.05)
        talk.come(value(address))
        talk.wait(0.1)
        assert batch.outcomes == [[address]]


def test_a_response_that_comes_too_early_is_not_the_one() -> None:
    talk = warm()
    talk.ask(100)
    talk.wait(1)
    present = talk.ask(101)
    talk.wait(1.002)
    talk.come(value(100))
    talk.wait(0.006)
    talk.come(value(101))
    talk.wait(0.1)
    assert present.outcomes == [[101]]
