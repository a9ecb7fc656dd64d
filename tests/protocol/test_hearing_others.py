"""
What a server that is unit 5 hears on a line: broadcasts, exceptions of others, bursts and damage.
"""

from __future__ import annotations

from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, Overheard, RtuFramer
from tests.support.cases import each_case
from tests.support.talk import rtu

BROADCAST = rtu("00 06 0001 0003")
OURS, OUR_WRITE = rtu("05 03 0000 0001"), rtu("05 06 0001 0003")
WRITE, REFUSAL = rtu("02 06 0001 0003"), rtu("02 86 02")
# No function of the specification is 80h or more; some devices answer with such a one.
STRANGE = rtu("02 C1 01 02 03 04")


def found(framer: RtuFramer, *bursts: bytes, size: int = 999) -> list[str]:
    """Return what is found in bursts, which come in pieces and end with silence."""
    given: list[Frame | FrameError] = []
    for burst in bursts:
        for at in range(0, len(burst), size):
            given += framer.scan(burst[at : at + size])
        given += framer.scan_silence()
    return [_named(each) for each in given]


def _named(each: Frame | FrameError) -> str:
    if isinstance(each, FrameError):
        return "damage"
    kind = "answer" if isinstance(each, Overheard) else "request"
    return f"{kind} {each.unit} {each.pdu[0]:02X}"


def unit_5() -> RtuFramer:
    framer = RtuFramer("server")
    framer.is_ours = lambda unit: unit == 5
    return framer


@each_case("size", [1, 3, 7, 999])
@each_case(
    ("bursts", "expected"),
    [
        ([BROADCAST] * 3, ["request 0 06"] * 3),
        ([BROADCAST + OURS, BROADCAST], ["request 0 06", "request 5 03", "request 0 06"]),
        ([OURS + OUR_WRITE + OURS], ["request 5 03", "request 5 06", "request 5 03"]),
        ([WRITE, WRITE, WRITE], ["request 2 06", "answer 2 06", "request 2 06"]),
        ([WRITE, REFUSAL, WRITE], ["request 2 06", "answer 2 86", "request 2 06"]),
        ([WRITE, STRANGE, WRITE], ["request 2 06", "answer 2 C1", "request 2 06"]),
        ([WRITE, BROADCAST, WRITE], ["request 2 06", "request 0 06", "request 2 06"]),
        ([WRITE, OURS + WRITE], ["request 2 06", "request 5 03", "request 2 06"]),
        ([rtu("02 80 01"), rtu("02 FF"), OURS], ["answer 2 80", "answer 2 FF", "request 5 03"]),
        ([STRANGE + OURS, OURS], ["damage", "request 5 03", "request 5 03"]),
        ([STRANGE[:-1], OURS], ["damage", "request 5 03"]),
        # What is unfinished: one of ours, and ones of others, and two frames behind it.
        ([b"\5\x10\0\0\0\1", OURS + OUR_WRITE], ["damage", "request 5 03", "request 5 06"]),
        ([b"\2\x10\0\0\0\1", OURS + OUR_WRITE], ["damage", "request 5 03", "request 5 06"]),
        ([b"\5\3\0", b"\2\3", OURS + OURS], ["damage", "request 5 03", "request 5 03"]),
    ],
)
def test_each_frame_is_what_it_is_in_any_pieces(
    bursts: list[bytes], expected: list[str], size: int
) -> None:
    assert found(unit_5(), *bursts, size=size) == expected


def test_our_request_is_found_with_its_last_byte() -> None:
    for request in (OURS, OUR_WRITE, BROADCAST):
        framer = unit_5()
        assert framer.scan(request[:-1]) == []
        assert framer.scan(request[-1:]) == [Frame(request[0], request[1:-2])]
        # Also as the second of two, though an answer that begins so would be longer.
        longer = rtu("05 03 FA00 0001")
        assert [_named(each) for each in framer.scan(OURS + longer)] == ["request 5 03"] * 2
        # And as the first of two.
        assert framer.scan(request + OURS[:3]) == [Frame(request[0], request[1:-2])]


def test_what_no_frame_can_be_long_enough_for_is_damage() -> None:
    """A frame has 256 bytes at most (serial line, 2.5.1)."""
    framer = unit_5()
    assert framer.scan(b"\2\xc1" + bytes(254)) == []
    assert framer.pending == 256
    assert [_named(each) for each in framer.scan(bytes(20))] == ["damage"]
    assert framer.pending <= 256
    framer.scan_silence()
    assert found(framer, OURS) == ["request 5 03"]
