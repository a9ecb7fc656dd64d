"""
Frames of ASCII: which delimiter ends them, and what a damaged one is.
"""

from __future__ import annotations

import pytest

from libmodbus_py import FrameError, pdu
from tests.support.talk import ASCII, LINE, Talk, ascii_frame, kinds, rtu, value


def test_an_accepted_delimiter_is_used_from_then_on_and_given_back_at_a_restart() -> None:
    talk = Talk(ASCII)
    talk.ask(pdu.Diagnostics(3, b"#\0"))
    assert talk.sent[-1] == b":010800032300D1\r\n"
    talk.come(b":010800032300D1\r\n")
    batch = talk.ask(1)
    assert talk.sent[-1].endswith(b"\r#")
    talk.come(ascii_frame("01 03 02 0001", b"\r#"))
    assert batch.outcomes == [[1]]
    talk.ask(pdu.Diagnostics(1, b"\0\0"))
    talk.come(ascii_frame("01 08 0001 0000", b"\r#"))
    talk.ask(1)
    assert talk.sent[-1].endswith(b"\r\n")


def test_a_refused_delimiter_is_not_used() -> None:
    talk = Talk(ASCII, delimiter=0x24)
    talk.ask(pdu.Diagnostics(3, b":\0"))
    talk.come(ascii_frame("01 88 03", b"\r$"))
    talk.ask(1)
    assert talk.sent[-1].endswith(b"\r$")


@pytest.mark.parametrize("data", [b":\0", b"\r\0", b"A\0", b"\xff\0", b"#\n"])
def test_a_delimiter_that_no_frame_can_have_is_not_used_if_a_device_echoes_it(data: bytes) -> None:
    talk = Talk(ASCII)
    batch = talk.ask(pdu.Diagnostics(3, data))
    talk.come(ascii_frame("01 08 0003" + data.hex()))
    assert batch.outcomes == [data]
    talk.lose()
    talk.open()  # with another framer
    batch = talk.ask(1, unit=2)
    assert talk.sent[-1].endswith(b"\r\n")
    talk.come(ascii_frame("02 03 02 0001"))
    assert batch.outcomes == [[1]]


def test_an_rtu_line_has_no_delimiter() -> None:
    talk = Talk(LINE)
    talk.ask(pdu.Diagnostics(3, b"#\0"))
    talk.come(rtu("01 08 0003 2300"))
    batch = talk.ask(1)
    talk.come(value(1))
    assert batch.outcomes == [[1]]


def test_a_damaged_answer_ends_the_wait_at_once() -> None:
    """Of ASCII, whose frames have an end: nothing more of it will come."""
    talk = Talk(ASCII, timeout=5)
    for frame in (b":0103020005F6\r\n", b":01030200zz\r\n", b":0183\r\n"):
        batch = talk.ask(5)
        talk.come(frame)
        assert kinds(batch) == [FrameError], frame
        assert batch.outcomes[0].received == frame
        talk.wait(11)


def test_noise_is_no_damaged_answer() -> None:
    talk = Talk(ASCII, timeout=5)
    batch = talk.ask(5)
    talk.come(b":7703020005F6\r\n")
    assert not batch.is_done
    talk.come(ascii_frame("01 03 02 0005"))
    assert batch.outcomes == [[5]]
