"""RTU frames in a stream of requests and responses, as a listener hears it."""

from libmodbus_py.protocol.rtu import Piece, RtuCutter, may_be
from tests.support.cases import each_case
from tests.support.driver import rtu
from tests.support.vectors import EXCEPTIONS, REQUESTS, RESPONSES, FrameVector, rows

ASK, ANSWER = rtu("01 03 00 00 00 02"), rtu("01 03 04 00 07 00 09")
WRITE = rtu("01 06 0001 0003")

# Functions that nobody knows have any length: silence ends them.
UNKNOWN = rtu("01 41 11 22 33 44")

# Claims 250 bytes.
CLAIM = bytes.fromhex("01 10 00 00 00 7B F6 00")

SILENCE, LONG_SILENCE = b"", None


def heard(*pieces: bytes | None) -> list[tuple[str, bytes]]:
    """Return what a listener hears; damage that follows damage belongs to it."""
    cutter, rest = RtuCutter("listener"), b""
    found: list[tuple[str, bytes]] = []
    for piece in pieces:
        rest += piece or b""
        cut, count = cutter.cut(rest, is_silent=not piece, is_over=piece is None)
        for start, end, kind in cut:
            if kind == "damage" and found and found[-1][0] == "damage":
                found[-1] = (kind, found[-1][1] + rest[start:end])
            else:
                found.append((kind, rest[start:end]))
        rest = rest[count:]
    return found


@each_case("vector", rows(REQUESTS))
def test_every_request_is_found(vector: FrameVector) -> None:
    assert heard(vector.rtu, LONG_SILENCE) == [("request", vector.rtu)]
    assert may_be(vector.pdu)[0]


@each_case("vector", rows([*RESPONSES, *EXCEPTIONS]))
def test_every_response_is_found_after_its_request(vector: FrameVector) -> None:
    asked = rtu(f"{vector.unit:02X} {vector.function:02X}")
    cutter = RtuCutter("listener")
    cutter._awaited = vector.unit, vector.function
    assert cutter.cut(vector.rtu, is_silent=True) == (
        [Piece(0, len(vector.rtu), "response")],
        len(vector.rtu),
    ), asked
    assert may_be(vector.pdu)[1]


def test_frames_after_damage_are_found() -> None:
    damaged = bytes([*ASK[:-1], ASK[-1] ^ 1])
    expected = [("request", ASK), ("damage", damaged), ("response", ANSWER), ("request", ASK)]
    # A longer frame may begin within the damage, until silence follows.
    assert heard(ASK, damaged, ANSWER, ASK, SILENCE) == expected
    assert heard(ASK + damaged + ANSWER + ASK, SILENCE) == expected


def test_noise_of_high_bytes_may_be_a_response_until_silence_follows() -> None:
    noise = b"\xff\xff"
    assert heard(ASK + noise + ANSWER) == [("request", ASK)]
    assert heard(ASK + noise + ANSWER, SILENCE) == [
        ("request", ASK),
        ("damage", noise),
        ("response", ANSWER),
    ]


def test_a_write_and_its_response_are_equal() -> None:
    for pieces in ([WRITE] * 3, [WRITE * 3], [WRITE, SILENCE, WRITE + WRITE]):
        assert [kind for kind, _ in heard(*pieces)] == ["request", "response", "request"]


def test_an_expected_response_is_waited_for() -> None:
    """Its first bytes are, by chance, a whole request; only the rest shows what it is."""
    longer = rtu("01 03 08 00 07 00" + rtu("01 03 08 00 07 00")[-2:].hex() + "AA BB CC")
    assert heard(ASK, longer[:8], longer[8:]) == [("request", ASK), ("response", longer)]
    # Without its request, the response is taken for the shorter frame.
    assert heard(longer[:8]) == [("request", longer[:8])]


@each_case("frame", [ASK, ANSWER, rtu("01 03 02 00 07"), rtu("01 83 02")])
def test_damage_does_not_hide_the_frame_after_a_silence(frame: bytes) -> None:
    damage, found = heard(CLAIM, SILENCE, frame, SILENCE)
    assert damage == ("damage", CLAIM)
    assert found[1] == frame


def test_damage_is_dropped_in_silence_if_frames_follow_to_the_end() -> None:
    assert heard(CLAIM + ASK + ANSWER) == []
    assert heard(CLAIM + ASK + ANSWER, SILENCE) == [
        ("damage", CLAIM),
        ("request", ASK),
        ("response", ANSWER),
    ]
    assert heard(b"\1" + ASK, SILENCE) == [("damage", b"\1"), ("request", ASK)]


def test_a_frame_without_a_length_ends_where_its_crc_fits_and_frames_follow() -> None:
    assert heard(UNKNOWN + ASK) == []  # later bytes may belong to the frame
    assert heard(UNKNOWN + ASK, SILENCE) == [("request", UNKNOWN), ("request", ASK)]
    assert heard(UNKNOWN, SILENCE) == [("request", UNKNOWN)]


@each_case("behind", ["4E 03 0000 0001", "4E 08 0000 7F2B", "4E 2B 0E 01 00"])
def test_a_request_without_a_pause_is_distinguished_from_a_loopback(behind: str) -> None:
    """The CRC of the loopback fits at several bytes."""
    loopback = rtu("4D 08 0000 7F2B")
    found = heard(loopback + rtu(behind), SILENCE)
    assert [data for _, data in found] == [loopback, rtu(behind)]


def test_a_loopback_whose_data_are_a_frame_is_one_frame() -> None:
    whole = rtu("4D 08 0000" + WRITE.hex())
    assert heard(whole, SILENCE) == [("request", whole)]


# Of a function without a length rule; the first is the beginning of the second.
SHORT = rtu("11 41")
LONG = rtu(SHORT.hex() + "01 02")


@each_case("size", [1, 3, 999])
@each_case("role", ["client", "listener"])
@each_case("frames", [[SHORT], [LONG], [SHORT, LONG], [LONG, SHORT], [SHORT, SHORT]])
def test_frames_with_a_common_beginning_are_told_apart_by_what_follows(frames, role, size) -> None:
    cutter, rest = RtuCutter(role), b""
    burst = b"".join(frames)
    for at in range(0, len(burst), size):
        rest += burst[at : at + size]
        assert cutter.cut(rest, is_silent=False) == ([], 0)
    found, count = cutter.cut(rest, is_silent=True)
    assert [rest[piece.start : piece.end] for piece in found] == frames
    assert count == len(burst)


def test_ambiguous_reads_and_answers_are_distinguished_by_their_order() -> None:
    ask, answer = rtu("12 01 0300 0011"), rtu("12 01 03 00 07 01")
    assert len(ask) == len(answer)
    for pieces in ([ask, answer] * 3, [(ask + answer) * 3]):
        assert heard(*pieces, SILENCE) == [("request", ask), ("response", answer)] * 3


def test_remaining_bytes_are_dropped_only_when_nothing_can_complete_a_frame() -> None:
    assert heard(ASK[:5], SILENCE) == []
    assert heard(ASK[:5], SILENCE, ASK[5:]) == [("request", ASK)]
    assert heard(ASK[:5], LONG_SILENCE, ASK) == [("damage", ASK[:5]), ("request", ASK)]


def test_a_function_of_80h_is_damage_when_no_frame_with_it_ends_with_silence() -> None:
    """There is no such function (application protocol, 4.1)."""
    assert heard(b"\1\x80" + ASK) == []
    assert heard(b"\1\x80" + ASK, SILENCE) == [("damage", b"\1\x80"), ("request", ASK)]
    alone = rtu("01 80 02 03")
    assert heard(alone, SILENCE) == [("response", alone)]


def test_the_number_of_kept_bytes_is_bounded() -> None:
    cutter, rest = RtuCutter("listener"), b""
    for piece in (b"\2\x08\0\0" + bytes(range(200)) * 3, b"\xff" * 1000, CLAIM * 100, b"\1\xc1"):
        rest += piece
        rest = rest[cutter.cut(rest, is_silent=False)[1] :]
        assert len(rest) <= 256
