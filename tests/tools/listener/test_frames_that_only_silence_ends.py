"""
What a listener makes of frames that only silence ends, with others right behind them.
"""

from __future__ import annotations

import pytest

from libmodbus_py.tools.listener.separator import LineFraming, Separator
from tests.server.test_server import BODIES, MADE
from tests.support.talk import rtu

ASK, ANSWER = "02 03 0000 0001", "02 03 02 0001"


def kinds(framing: LineFraming, bodies: list[str]) -> list[str]:
    """Return what the frames are called, with silence between them."""
    separator, done = Separator(framing), []
    for number, body in enumerate(bodies):
        done += separator.feed(MADE[framing](body), number / 10)
    return [each.kind for each in done + separator.end()]


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_a_good_frame_that_nobody_sends_is_no_damage(framing: LineFraming) -> None:
    """It is an exception to something that was not asked, or invalid."""
    for body in ["00", "00 01 02 03", *BODIES]:
        found = kinds(framing, [ASK, ANSWER, f"02 {body}", ASK, ANSWER])
        assert found[0] == found[-1] == "answered", body
        assert found[1:-1] in (["unasked"], ["invalid"]), body


def test_a_wrong_crc_is_damage() -> None:
    separator = Separator("rtu")
    done = separator.feed(rtu("02 83 02 00")[:-1] + b"\x00", 0.0)
    assert [each.kind for each in done + separator.end()] == ["damaged"]
