"""
A unit that stood still, and then responds to all requests that it received, in their order.

Nothing in RTU tells its first response from that to the present request, but the second one does,
which comes while the first one is held.
"""

from __future__ import annotations

import pytest

from libmodbus_py import InvalidResponse
from tests.client.test_doubled_answers import warm
from tests.support.talk import kinds, value


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
    assert not present.is_done
    talk.wait(0.01)
    talk.come(value(101))
    assert kinds(present) == [InvalidResponse]
    for address in range(102, 110):
        talk.wait(pause)
        batch, count = talk.ask(address), len(talk.sent)
        talk.wait_for(count + (address == 102))  # the line must be silent
        talk.wait(0.01)
        talk.come(value(address))
        talk.wait(0.1)
        assert batch.outcomes == [[address]]
