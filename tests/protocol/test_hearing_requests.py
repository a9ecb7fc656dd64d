"""
What a server hears on a line with other units: their answers, frames within frames, broadcasts,
bursts and damage.
"""

from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame, OverheardResponse, RtuFramer
from tests.support.cases import each_case
from tests.support.driver import rtu
from tests.support.vectors import REQUESTS, RESPONSES, FrameVector, rows

FoundUnit = list[Frame | FrameError]

WRITE = rtu("01 06 0001 0003")
READ = rtu("01 03 0000 0001")
WRITTEN = Frame(1, WRITE[1:-2])
ASKED = Frame(1, READ[1:-2])


def framer_of(*units: int) -> RtuFramer:
    framer = RtuFramer("server")
    framer.is_ours = lambda unit: unit in units
    return framer


def heard(*bursts: bytes, size: int = 999, unit: int = 1) -> FoundUnit:
    """Everything that a unit finds in bursts, which come in pieces and end with silence."""
    framer = framer_of(unit)
    results: FoundUnit = []
    for burst in bursts:
        for at in range(0, len(burst), size):
            results += framer.scan(burst[at : at + size])
        results += framer.scan_silence()
    return results


def requests(results: FoundUnit, unit: int = 1) -> list[Frame]:
    return [result for result in results if type(result) is Frame and result.unit == unit]


def with_data(head: str, *data: bytes) -> bytes:
    return rtu((bytes.fromhex(head) + b"".join(data)).hex())


def crc_of(data: bytes) -> int:
    return int.from_bytes(rtu(data.hex())[-2:], "little")


# Requests to unit 2, and answers of it, in which a whole write to unit 1 stands.
AROUND = {
    "an answer to a read": (rtu("02 03 0000 0008"), with_data("02 03 10", WRITE, WRITE)),
    "an answer with two bytes more": (
        rtu("02 03 0000 0009"),
        with_data("02 03 12", WRITE * 2, b"ab"),
    ),
    "coils": (rtu("02 01 0000 0040"), with_data("02 01 08", WRITE)),
    "a server id": (rtu("02 11"), with_data("02 11 0A", b"\7\xff", WRITE)),
    "a file": (rtu("02 14 07 06 0004 0001 0004"), with_data("02 14 0A 09 06", WRITE)),
    "loopback": (with_data("02 08 0000", WRITE), with_data("02 08 0000", WRITE)),
    "long loopback": (with_data("02 08 0000", WRITE * 20), with_data("02 08 0000", WRITE * 20)),
    "canopen": (with_data("02 2B 0D 01", WRITE), with_data("02 2B 0D 01", WRITE)),
    "unknown function": (with_data("02 41", WRITE), with_data("02 41", WRITE, READ)),
    "a write": (with_data("02 10 0000 0004 08", WRITE), rtu("02 10 0000 0004")),
}


@each_case("size", [1, 3, 7, 64, 999])
@each_case("name", AROUND)
def test_no_part_of_a_frame_of_others_is_a_request(name: str, size: int) -> None:
    ask, answer = AROUND[name]
    for bursts in ((ask, answer), (ask + answer,), (answer,), (ask, answer, ask, answer)):
        results = heard(*bursts, size=size)
        assert requests(results) == [], bursts
        assert not any(isinstance(result, FrameError) for result in results), (bursts, results)


@each_case("size", [1, 3, 999])
@each_case("name", AROUND)
def test_a_request_behind_frames_of_others_is_found(name: str, size: int) -> None:
    ask, answer = AROUND[name]
    for bursts in ((ask, answer, READ), (ask + answer, READ), (ask, answer + READ)):
        assert requests(heard(*bursts, size=size)) == [ASKED], bursts


@each_case("head", ["01 08 0000", "01 2B 0D", "01 41"])
def test_a_frame_without_a_length_ends_with_silence_and_not_where_its_crc_fits_first(head) -> None:
    """Its data begin with a CRC that fits, and go on with a write."""
    early = with_data(head, b"\1\2")
    whole = with_data("", early, WRITE, b"\5\6")
    for size in (1, 999):
        assert requests(heard(whole, size=size)) == [Frame(1, whole[1:-2])]


def test_a_refusal_to_another_unit_after_a_request_is_one_frame() -> None:
    """Of a function without a class, whose refusal may have any length."""
    others = rtu("02 C1 11 22 33 44")
    for size in (1, 999):
        results = heard(READ + others, size=size)
        assert results == [ASKED, OverheardResponse(2, others[1:-2])]


def test_the_end_of_a_frame_of_unknown_length_is_not_guessed() -> None:
    """
    The answer to a loopback repeats it. Its data are chosen so that the CRC of both together fits
    in the midst of the answer, right before a write.
    """
    head = "02 08 0000 000000000000 C60A"
    both = rtu(head + WRITE.hex())
    place = len(both) + len(bytes.fromhex(head))
    first, rest = (both + both)[:place], (both + both)[place:]
    assert crc_of(first[:-2]) == int.from_bytes(first[-2:], "little")
    assert rest.startswith(WRITE)
    assert requests(heard(both + both)) == []
    assert requests(heard(both + both, READ)) == [ASKED]


def test_an_expected_answer_may_begin_like_a_shorter_request() -> None:
    """Registers of unit 2 are chosen so that its answer begins with a request to unit 2."""
    begin = rtu("02 03 14 00 07 00")
    answer = with_data("", begin, WRITE, bytes(23 - len(begin) - len(WRITE)))
    for size in (1, 8, 9, 999):
        results = heard(rtu("02 03 0000 000A"), answer, size=size)
        assert requests(results) == []
        assert results[-1] == OverheardResponse(2, answer[1:-2])
        # Nor if its request was not heard.
        assert requests(heard(answer, size=size)) == []


def test_a_pause_inside_an_answer_yields_no_request() -> None:
    ask, answer = AROUND["an answer to a read"]
    for cut in range(1, len(answer)):
        assert requests(heard(ask, answer[:cut], answer[cut:])) == [], cut


def test_a_request_after_damage_counts_only_close_to_the_silence() -> None:
    for noise in (b"\0", b"\xff\xff", b"\1\3", bytes(range(40))):
        assert requests(heard(noise + READ)) == [ASKED], noise
        assert requests(heard(noise + READ + WRITE)) == [ASKED, WRITTEN], noise
        for size in range(1, 7):
            frames = [ASKED] if len(noise) <= 4 and size <= 4 else []
            assert requests(heard(noise + READ + bytes(size))) == frames, (noise, size)
    # What may be the beginning of an awaited answer lasts until the next burst.
    head, ask = b"\2\3\x10\xff", rtu("02 03 0000 0008")
    assert requests(heard(ask, head + READ)) == []
    assert requests(heard(ask, head + READ, READ)) == [ASKED]
    assert requests(heard(head + READ)) == [ASKED]
    frame = bytearray(AROUND["an answer to a read"][1])
    frame[3] ^= 1
    assert requests(heard(bytes(frame))) == []
    assert requests(heard(bytes(frame), READ)) == [ASKED]


# Bytes that transceivers add: of a line that is low, high or floats, and beginnings of frames.
NOISES = [b"", b"\0", b"\xff", b"\0\xff", b"\1", b"\2\3", b"\1\x10\0", b"\xf8\0\x7e\x80"]


@each_case("before", NOISES)
@each_case("behind", NOISES)
@each_case("size", [1, 999])
def test_a_request_between_noise_is_found(before: bytes, behind: bytes, size: int) -> None:
    for vector in REQUESTS:
        if vector.pdu[0] in NO_LENGTH and behind.startswith(b"\0"):
            continue  # behind a CRC that fits it fits again
        request, read = (with_data(f"{vector.unit:02X}", item) for item in (vector.pdu, READ[1:-2]))
        results = heard(
            before + request + behind, before + read + behind, size=size, unit=vector.unit
        )
        frames = [Frame(vector.unit, vector.pdu), Frame(vector.unit, READ[1:-2])]
        assert requests(results, vector.unit) == frames, vector.id


NO_LENGTH = (8, 43)


@each_case("before", NOISES)
@each_case("behind", NOISES)
@each_case("name", AROUND)
def test_bytes_in_a_frame_of_others_between_noise_are_no_request(name, before, behind) -> None:
    ask, answer = (before + entry + behind for entry in AROUND[name])
    for bursts in ((ask, answer), (answer,)):
        assert requests(heard(*bursts)) == [], bursts


@each_case("head", ["02 03 08", "02 01 08", "02 11 08"])
def test_bytes_in_a_damaged_answer_of_others_are_no_request(head: str) -> None:
    answer = with_data(head, WRITE)
    for place in (3, 5, len(answer) - 1):
        frame = bytearray(answer)
        frame[place] ^= 4
        for bursts in ([frame], [rtu("02 03 0000 0004"), frame]):
            assert requests(heard(*map(bytes, bursts))) == [], place


@each_case("size", [1, 999])
@each_case(
    ("burst", "name"),
    [
        # From libmodbus's unit tests: 0 registers, and six bytes more than counted.
        (rtu("05 10 0160 0000 00 000000000000"), "request 5 10"),
        (rtu("05 10 0160 0002 08 00010002"), "request 5 10"),
        (rtu("05 0F 0130 0008 02 FF"), "request 5 0F"),
        (rtu("05 03 0160 0001 00"), "request 5 03"),
        (rtu("05 03 0160 00"), "request 5 03"),
        (rtu("05 83 02 00"), "answer 5 83"),
        (rtu("02 03 0160 0001 00"), "answer 2 03"),
        (rtu("02 10 0160 0000 00 000000000000"), "answer 2 10"),
    ],
)
def test_a_burst_with_a_valid_crc_is_one_frame_of_any_length(burst, name, size) -> None:
    assert named(heard(burst, OURS, size=size, unit=5)) == [name, "request 5 03"]
    assert named(heard(burst + OUR_WRITE, OURS, size=size, unit=5))[-1] == "request 5 03"


def test_the_beginning_of_a_longer_frame_to_others_is_no_request() -> None:
    """Its beginning has a right CRC, by chance."""
    begin = rtu("02 03 14 00 07")
    answer = with_data("", begin, WRITE, bytes(23 - len(begin) - len(WRITE)))
    results = heard(rtu("02 03 0000 000A"), begin, answer[len(begin) :])
    assert named(results) == ["request 2 03", "answer 2 03"]


@each_case("vector", rows(RESPONSES))
def test_answers_of_others_are_no_damage(vector: FrameVector) -> None:
    assert vector.unit != 99
    framer = framer_of(99)
    results = framer.scan(vector.rtu) + framer.scan_silence()
    assert [result[:2] for result in results if isinstance(result, Frame)] == [vector.frame[:2]]
    assert len(results) == 1


def test_only_scan_returns_answers_of_others() -> None:
    ask, answer = AROUND["an answer to a read"]
    framer = framer_of(1)
    assert framer.scan(ask + answer) == [Frame(2, ask[1:-2]), OverheardResponse(2, answer[1:-2])]
    assert framer.feed(ask + answer + READ) == [Frame(2, ask[1:-2]), ASKED]


def test_a_request_that_is_repeated_to_a_silent_unit_is_not_taken_for_its_answer() -> None:
    ask = rtu("02 03 5000 0001")
    assert requests(heard(ask, ask, ask, READ), 2) == [Frame(2, ask[1:-2])] * 3
    assert requests(heard(ask, ask, READ)) == [ASKED]


def test_after_another_request_no_answer_to_the_first_is_expected() -> None:
    """A write and its answer are the same bytes: what was heard before tells which it is."""
    write = rtu("02 06 0001 0003")
    request, answer = Frame(2, write[1:-2]), OverheardResponse(2, write[1:-2])
    assert heard(write, write) == [request, answer]
    assert heard(write, write, write) == [request, answer, request]
    assert heard(write, READ, write) == [request, ASKED, request]
    assert heard(write, READ + write) == [request, ASKED, request]
    other = rtu("03 03 0000 0001")
    assert heard(write, other, write) == [request, Frame(3, other[1:-2]), request]


BROADCAST = rtu("00 06 0001 0003")
OURS, OUR_WRITE = rtu("05 03 0000 0001"), rtu("05 06 0001 0003")
OTHERS, REFUSAL = rtu("02 06 0001 0003"), rtu("02 86 02")
# No function of the specification is 80h or more; some devices answer with such a one.
STRANGE = rtu("02 C1 01 02 03 04")


def named(results: FoundUnit) -> list[str]:
    return [_name(result) for result in results]


def _name(each: Frame | FrameError) -> str:
    if isinstance(each, FrameError):
        return "damage"
    kind = "answer" if isinstance(each, OverheardResponse) else "request"
    return f"{kind} {each.unit} {each.pdu[0]:02X}"


@each_case("size", [1, 3, 7, 999])
@each_case(
    ("bursts", "names"),
    [
        ([BROADCAST] * 3, ["request 0 06"] * 3),
        ([BROADCAST * 2 + OURS], ["request 0 06", "request 0 06", "request 5 03"]),
        ([OURS + OUR_WRITE + OURS], ["request 5 03", "request 5 06", "request 5 03"]),
        ([OTHERS, OTHERS, OTHERS], ["request 2 06", "answer 2 06", "request 2 06"]),
        ([OTHERS, REFUSAL, OTHERS], ["request 2 06", "answer 2 86", "request 2 06"]),
        ([OTHERS, STRANGE, OTHERS], ["request 2 06", "answer 2 C1", "request 2 06"]),
        ([OTHERS, BROADCAST, OTHERS], ["request 2 06", "request 0 06", "request 2 06"]),
        ([OTHERS, OURS + OTHERS], ["request 2 06", "request 5 03", "request 2 06"]),
        ([rtu("02 80 01"), rtu("02 FF"), OURS], ["answer 2 80", "answer 2 FF", "request 5 03"]),
        ([STRANGE + OURS, OURS], ["damage", "request 5 03", "request 5 03"]),
        ([STRANGE[:-1], OURS], ["damage", "request 5 03"]),
        # What is unfinished: one of ours, and ones of others, and two frames behind it.
        ([b"\5\x10\0\0\0\1", OURS + OUR_WRITE], ["damage", "request 5 03", "request 5 06"]),
        ([b"\2\x10\0\0\0\1", OURS + OUR_WRITE], ["damage", "request 5 03", "request 5 06"]),
        ([b"\5\3\0", b"\2\3", OURS + OURS], ["damage", "request 5 03", "request 5 03"]),
    ],
)
def test_each_frame_keeps_its_kind_in_any_pieces(bursts, names, size) -> None:
    assert named(heard(*bursts, size=size, unit=5)) == names


def test_our_request_is_found_with_its_last_byte() -> None:
    begun_answers = rtu("05 03 FA00 0001"), rtu("05 01 7B00 0001")
    for request in (OURS, OUR_WRITE, BROADCAST, *begun_answers):
        framer = framer_of(5)
        assert framer.scan(request[:-1]) == []
        assert framer.scan(request[-1:]) == [Frame(request[0], request[1:-2])]
        # Also as the second of two, though an answer that begins so would be longer.
        longer = rtu("05 03 FA00 0001")
        assert named(framer.scan(OURS + longer)) == ["request 5 03"] * 2
        # And as the first of two.
        assert framer.scan(request + OURS[:3]) == [Frame(request[0], request[1:-2])]


def test_more_bytes_than_the_longest_frame_are_damage() -> None:
    """A frame has 256 bytes at most (serial line, 2.5.1)."""
    framer = framer_of(5)
    assert framer.scan(b"\2\xc1" + bytes(254)) == []
    assert framer.pending == 256
    assert named(framer.scan(bytes(20))) == ["damage"]
    assert framer.pending <= 256
    framer.scan_silence()
    assert named(framer.scan(OURS) + framer.scan_silence()) == ["request 5 03"]
