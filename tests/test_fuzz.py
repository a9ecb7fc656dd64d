"""
Random bytes and mutations of worked examples, for everything that takes bytes from a wire.

What must hold stands in fuzz/checks.py; ``./run fuzz`` drives the same with coverage.
"""

import re
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.checks import (
    FILES,
    FRAMERS,
    REQUEST_OBJECTS,
    check_datagrams,
    check_device,
    check_device_file,
    check_file,
    check_listening,
    check_request,
    check_response,
    check_stream,
    examples,
)
from fuzz.hostile import UNIT, Hostile, Innocent
from fuzz.listening import LATENCY, Framing, measure
from fuzz.transactions import known_device
from libmodbus_py import Server, pdu
from tests.support.cases import each_case

PLANT = (Path(__file__).parents[1] / "examples" / "plant.toml").read_text()

FORMS = {"tcp": "tcp", "rtu server": "rtu", "rtu client": "rtu", "ascii": "ascii"}


@st.composite
def mutated(draw: st.DrawFn, form: str) -> bytes:
    """An example with some damage: cut, doubled, overwritten, flipped, or none."""
    data = draw(st.sampled_from(examples(form)))
    for _ in range(draw(st.integers(0, 3))):
        start = draw(st.integers(0, len(data)))
        stop = draw(st.integers(start, len(data)))
        match draw(st.sampled_from(["cut", "double", "insert", "overwrite", "flip"])):
            case "cut":
                data = data[:start] + data[stop:]
            case "double":
                data = data[:stop] + data[start:]
            case "insert":
                data = data[:start] + draw(st.binary(max_size=6)) + data[start:]
            case "overwrite":
                data = data[:start] + bytes([draw(st.integers(0, 255))]) + data[start + 1 :]
            case "flip" if start < len(data):
                flipped = data[start] ^ 1 << draw(st.integers(0, 7))
                data = data[:start] + bytes([flipped]) + data[start + 1 :]
    return data


def streams(form: str) -> st.SearchStrategy[bytes]:
    """Some of them in a row, with noise in between."""
    return st.lists(mutated(form) | st.binary(max_size=12), max_size=7).map(b"".join)


sizes = st.lists(st.integers(0, 20), max_size=40)


WORDS = [
    *re.findall(r"\[+[\w.]+\]+|\w+ = [^#\n]+", PLANT),
    "{",
    "}",
    "[",
    "]",
    ",",
    "=",
    "-",
    "1e99",
]
WORDS += [
    "9" * 400,
    "inf",
    "nan",
    "true",
    "65535",
    "count = 65536",
    '"x"',
    "a.b.c",
    "\n",
    "'''",
    "#",
]


@settings(max_examples=60)
@given(st.lists(st.sampled_from(WORDS) | st.text(max_size=3), max_size=25))
def test_any_device_file_is_loaded_or_refused(words: list[str]) -> None:
    """Parts of the example in any order."""
    check_device_file("[[unit]]\n" + "\n".join(words))


TEXTS = ["[[point]]", "[[route]]", "[[device]]", "[output.json]", "name;url;unit", "name,address"]
TEXTS += ["name = 'a'", "url = 1", "unit = 300", "a;tcp://h;1", "a,40001", '"', "\0", "\n", "# x"]


@settings(max_examples=60)
@given(st.sampled_from(sorted(FILES)), st.lists(st.sampled_from(TEXTS) | st.text(max_size=3)))
def test_any_lines_in_files_are_loaded_or_refused(kind: str, lines: list[str]) -> None:
    check_file(kind, "\n".join(lines))


ODD_VALUES = ["9" * 400, "9" * 5000, "0x" + "f" * 5000, "-1", "0", "1e400", "inf", "nan", "true"]
ODD_VALUES += ["''", f"'{'x' * 300}'", "2024-01-01", "[]", "{}", "[" * 2000, "{ x = " * 2000, "'"]


@each_case(("at", "odd"), enumerate(ODD_VALUES))
def test_device_files_with_an_odd_value_are_loaded_or_refused(at: int, odd: str) -> None:
    """The example, with another value in the place of every sixth one."""
    for place in [*re.finditer(r"= ([^\s,}]+)", PLANT)][at % 6 :: 6]:
        check_device_file(PLANT[: place.start(1)] + odd + PLANT[place.end(1) :])


@each_case("name", FRAMERS)
@settings(max_examples=60)
@given(st.data())
def test_any_stream_is_cut_into_frames(name: str, data: st.DataObject) -> None:
    check_stream(name, data.draw(streams(FORMS[name])), data.draw(sizes))


@pytest.mark.parametrize(
    ("name", "stream", "first"),
    [
        # An unfinished frame behind a byte that belongs to none.
        ("ascii", b"\0::0603007A00037A\r\n", 1),
        # The refusal of a function without a class, behind damage: CRC of FF FF is 0.
        ("rtu client", b"\xff\xff\xff\xff\xff\xff\0\0\0", 5),
    ],
)
def test_streams_of_guided_fuzzing_are_cut_into_frames(name: str, stream: bytes, first: int):
    check_stream(name, stream, [first])


gaps = st.sampled_from([0.0, 0.0005, 0.005, 0.05, 0.4, 2.0, 9.0])


@each_case("framing", ["rtu", "ascii"])
@settings(max_examples=60)
@given(st.data())
def test_listeners_accept_any_bytes(framing: Literal["rtu", "ascii"], data: st.DataObject) -> None:
    pieces = st.tuples(gaps, mutated(framing) | st.binary(max_size=12))
    check_listening(framing, data.draw(st.lists(pieces, max_size=12)))


@pytest.mark.parametrize(
    ("framing", "faults", "least"),
    [("rtu", 0.0, 1.0), ("rtu", 0.01, 0.99), ("ascii", 0.0, 1.0), ("ascii", 0.01, 0.99)],
)
def test_a_listener_decodes_most_transactions(framing: Framing, faults: float, least: float):
    """`fuzz.listening` does it for longer."""
    assert measure(framing, 1000, faults, 5, LATENCY).share >= least


@settings(max_examples=60)
@given(st.lists(mutated("tcp") | st.binary(max_size=270), max_size=8))
def test_any_datagrams_are_answered_or_dropped(datagrams: list[bytes]) -> None:
    check_datagrams(datagrams)


def near_pdus() -> st.SearchStrategy[bytes]:
    return mutated("pdu").map(lambda data: data[: pdu.MAX_PDU])


@settings(max_examples=250)
@given(near_pdus() | st.binary(max_size=260))
def test_any_request_is_decoded_or_refused(data: bytes) -> None:
    check_request(data)


@each_case("request_", REQUEST_OBJECTS, ids=[type(item).__name__ for item in REQUEST_OBJECTS])
@settings(max_examples=35)
@given(data=near_pdus() | st.binary(max_size=260), mark=st.sampled_from([None, 0, 0x80]))
def test_any_response_is_result_or_error(request_: pdu.Request[Any], data: bytes, mark: int | None):
    """Also those to other requests, as if they answered or refused this one."""
    check_response(request_, data if mark is None else bytes([request_.function | mark]) + data[1:])


@settings(max_examples=60)
@given(st.lists((near_pdus() | st.binary(max_size=20)).filter(bool), max_size=12))
def test_a_device_answers_any_requests(requests: list[bytes]) -> None:
    check_device(requests)


@pytest.mark.parametrize("seed", range(3))
def test_a_client_gets_its_values_among_hostile_clients(seed: int) -> None:
    device = known_device()
    before = bytes(device.mapping.holding_registers.view)
    with Server({UNIT: device}).background("tcp://127.0.0.1:0") as running:
        port = int(running.urls[0].rpartition(":")[2])
        with Hostile(port, seed) as hostile, Innocent(port, seed) as innocent:
            while hostile.streams < 60:
                innocent.read()
        assert innocent.findings == []
        assert innocent.reads > 0
        assert all(hostile.by_kind.values())
    assert bytes(device.mapping.holding_registers.view) == before
