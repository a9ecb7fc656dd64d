"""
Serial lines on which things go wrong: no wrong value, no silent loss, one failure for each fault.

The long run of the same is ``fuzz.serial_faults``.
"""

import random

import pytest

from fuzz.bad_line import FAULTS, BadLine, Framing, Hurt
from fuzz.serial_faults import LINES, on_a_line
from libmodbus_py.protocol.framing import AsciiFramer, Frame, Framer, Role, RtuFramer
from tests.support.vectors import FRAMES, FrameVector

TIMEOUT = 0.15


@pytest.mark.parametrize("name", LINES)
def test_every_injected_fault_is_noticed(name: str) -> None:
    numbers = iter(range(150))
    tally = on_a_line(name, TIMEOUT, 20, lambda: next(numbers, None) is not None)
    assert tally.is_good, f"\n{tally}"
    assert tally.injected.total() > 0
    assert tally.errors.total() > 0


def test_injected_damage_is_what_a_framing_can_detect() -> None:
    """Damage gives no frame but the one that was sent; lateness does no damage."""
    framings: tuple[Framing, ...] = ("rtu", "ascii")
    for vector in FRAMES:
        chance = random.Random(vector.id)
        for framing in framings:
            frame: bytes = getattr(vector, framing)
            for kind in ("flip", "burst", "lose", "cut", "double", "delay"):
                for _ in range(10):
                    pieces = FAULTS[kind](Hurt(frame, framing, chance))
                    results = frames(framing, vector, [piece.data for piece in pieces])
                    message = f"{vector.id} {framing} {kind}: {results}"
                    assert set(results) <= {vector.frame}, message
                    assert results or kind != "delay", message


def frames(framing: Framing, vector: FrameVector, pieces: list[bytes]) -> list[Frame]:
    """Return the frames that the receiving side finds in these bytes."""
    role: Role = "server" if vector.kind == "request" else "client"
    framer: Framer = RtuFramer(role) if framing == "rtu" else AsciiFramer()
    events = [frame for piece in pieces for frame in framer.scan(piece)] + framer.scan_silence()
    return [event for event in events if isinstance(event, Frame)]


def test_an_injector_that_is_off_changes_nothing() -> None:
    numbers = iter(range(100))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BadLine, "arm", lambda *_: None)
        tally = on_a_line("RTU", 2, 3, lambda: next(numbers, None) is not None)
    assert (tally.done, tally.injected.total(), tally.errors.total()) == (100, 0, 0)
