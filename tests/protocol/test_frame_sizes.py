"""
The longest frame of each framing, and what damage is called that is too long.
"""

from __future__ import annotations

import pytest

from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, Framing, make_framer

# Application protocol, section 4.1: a PDU has 253 bytes at most; the ADU of a serial line 256,
# that of TCP 260. Serial line, section 2.5.2.1: in ASCII mode 513 characters.
LONGEST: list[tuple[Framing, int]] = [("tcp", 260), ("udp", 260), ("rtu", 256), ("ascii", 513)]

# Function 23 with 125 registers read and 121 written is the longest of the worked functions.
PDU = bytes.fromhex("17 0000 007d 0000 0079 f2") + bytes(242)


@pytest.mark.parametrize(("framing", "size"), LONGEST)
def test_the_longest_frame_has_the_size_that_its_framing_allows(
    framing: Framing, size: int
) -> None:
    framer = make_framer(framing, "client")
    whole = framer.encode(Frame(1, PDU + bytes(253 - len(PDU))))
    assert len(whole) == getattr(framer, "max_size", size) == size  # a stream has no limit
    with pytest.raises(ValueError, match=r"254"):
        framer.encode(Frame(1, bytes(254)))


@pytest.mark.parametrize("framing", dict(LONGEST))
def test_the_longest_request_arrives(framing: Framing) -> None:
    framer = make_framer(framing, "server")
    found = framer.scan(framer.encode(Frame(1, PDU))) + framer.scan_silence()
    assert [each[:2] for each in found if isinstance(each, Frame)] == [(1, PDU)]


def errors(framing: Framing, data: bytes) -> list[FrameError]:
    framer = make_framer(framing, "server")
    found = framer.scan(data) + framer.scan_silence()
    assert found
    assert all(isinstance(each, FrameError) for each in found), found
    return [each for each in found if isinstance(each, FrameError)]


def test_only_too_many_characters_are_an_overrun() -> None:
    assert [each.overrun for each in errors("ascii", b":" + b"00" * 300)] == [True]
    assert {each.overrun for each in errors("ascii", b":010300000001FF\r\n")} == {False}
    assert {each.overrun for each in errors("ascii", b":0103zz")} == {False}
    assert {each.overrun for each in errors("rtu", bytes.fromhex("01 03 0000 0001 ffff"))} == {
        False
    }
