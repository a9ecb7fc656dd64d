"""
``Server(trace=...)``: every ADU as it was on the wire, whatever becomes of it, and whatever the
callback does.
"""

import logging
import socket
import threading
import time
import tracemalloc
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import pairwise
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Fault,
    Gateway,
    Hook,
    IllegalFunction,
    Mapping,
    ModbusError,
    Route,
    Server,
    ServerDeviceFailure,
    TracedFrame,
)
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.lan import Lan
from tests.support.attacks import ask, connect
from tests.support.cases import each_case
from tests.support.certificates import Pki, secured
from tests.support.driver import ascii_frame, rtu
from tests.support.peers import until
from tests.support.transports import serving

READ = bytes.fromhex("0001 0000 0006 11 03 0000 0002")
ANSWER = bytes.fromhex("0001 0000 0007 11 03 04 0007 0008")


def made_device(**options: Any) -> Device:
    return Device(Mapping(holding_registers={0: [7, 8]}), **options)


@contextmanager
def connected(
    trace: Callable[[TracedFrame], object] | None, url: str = "tcp://127.0.0.1:0", **options: Any
) -> Iterator[tuple[socket.socket, str]]:
    """A server of unit 17, a connection to it, and its URL."""
    units = options.pop("units", None) or {17: made_device()}
    with (
        Server(units, trace=trace, **options).background(url) as running,
        connect(running.urls[0]) as one,
    ):
        yield one, running.urls[0]


def said(frames: list[TracedFrame]) -> list[tuple[str, bytes]]:
    return [(frame.direction, frame.adu) for frame in frames]


FRAMED: dict[str, Callable[[str], bytes]] = {
    "tcp": lambda body: b"\0\1\0\0" + len(bytes.fromhex(body)).to_bytes(2) + bytes.fromhex(body),
    "udp": lambda body: b"\0\1\0\0" + len(bytes.fromhex(body)).to_bytes(2) + bytes.fromhex(body),
    "rtu+tcp": rtu,
    "ascii+tcp": ascii_frame,
}


@pytest.mark.parametrize("scheme", FRAMED)
def test_frames_are_traced_as_they_are_on_the_wire(scheme: str) -> None:
    frames: list[TracedFrame] = []
    frame = FRAMED[scheme]
    request, answer = frame("11 03 0000 0002"), frame("11 03 04 0007 0008")
    beyond, refusal = frame("11 03 FFFF 0001"), frame("11 83 02")
    before = time.time()
    with connected(frames.append, f"{scheme}://127.0.0.1:0") as (connection, url):
        here = "{}:{}".format(*connection.getsockname())
        ask(connection, request, answer)
        ask(connection, beyond, refusal)
        until(lambda: len(frames) == 4)
    assert said(frames) == [
        ("received", request),
        ("sent", answer),
        ("received", beyond),
        ("sent", refusal),
    ]
    assert [(frame.unit, frame.function) for frame in frames] == [(17, 3)] * 3 + [(17, 0x83)]
    assert {(frame.endpoint, frame.peer) for frame in frames} == {(url, here)}
    assert all(one.time <= other.time for one, other in pairwise(frames))
    assert before <= frames[0].time <= time.time()


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
def test_a_serial_port_is_traced_with_its_name(scheme: str) -> None:
    frames: list[TracedFrame] = []
    with SerialWire() as wire:
        url = f"{scheme}://{wire.server}?baudrate=115200"
        client = Client(f"{scheme}://{wire.client}?baudrate=115200", unit=17)
        with Server({17: made_device()}, trace=frames.append).background(url), client as plc:
            assert plc.read_holding_registers(0, 2) == [7, 8]
    assert [(frame.direction, frame.peer) for frame in frames] == [
        ("received", wire.server),
        ("sent", wire.server),
    ]


def test_a_trace_of_tls_shows_plain_frames(pki: Pki) -> None:
    frames: list[TracedFrame] = []
    server = Server({17: made_device()}, trace=frames.append)
    with secured(server, pki) as url, Client(url, unit=17) as plc:
        assert plc.read_holding_registers(0, 2) == [7, 8]
    assert [frame.adu[6:] for frame in frames] == [READ[6:], ANSWER[6:]]


@pytest.mark.parametrize("faults", [{}, {17: [Fault("delay", seconds=0.001, every=10**6)]}])
def test_requests_in_one_chunk_are_traced_one_by_one(faults: dict[int, list[Fault]]) -> None:
    frames: list[TracedFrame] = []
    with connected(frames.append, faults=faults) as (one, url), connect(url) as slow:
        ask(one, READ * 40, ANSWER * 40)
        for at in range(len(READ)):
            slow.sendall(READ[at : at + 1])
            time.sleep(0.001)
        ask(slow, b"", ANSWER)
    assert sorted(said(frames)) == sorted([("received", READ), ("sent", ANSWER)] * 41)


GARBAGE = b"\xff\xff"

# What a fault sends in place of an answer: bytes, and the unit if they are a frame.
SPOILT = [
    (Fault("no_answer", every=2), []),
    (Fault("truncate", every=2, length=5), [(ANSWER[:5], None)]),
    (Fault("trickle", every=2, seconds=0.001), [(ANSWER, 17)]),
    (Fault("wrong_check", every=2), [(ANSWER[:4] + b"\0\0" + ANSWER[6:], None)]),
    (Fault("wrong_unit", every=2), [(ANSWER[:6] + b"\x12" + ANSWER[7:], 18)]),
    (Fault("exception", every=2, code=6), [(ANSWER[:4] + bytes.fromhex("0003 11 83 06"), 17)]),
    (Fault("garbage", every=2, data=GARBAGE), [(GARBAGE, None), (ANSWER, 17)]),
    (Fault("garbage", every=2, data=GARBAGE, place="instead"), [(GARBAGE, None)]),
    (Fault("garbage", every=2, data=GARBAGE, place="behind"), [(ANSWER, 17), (GARBAGE, None)]),
]


@each_case(("fault", "spoilt"), SPOILT)
def test_a_damaged_answer_is_traced_as_sent_and_the_next_one_completely(fault, spoilt) -> None:
    frames: list[TracedFrame] = []
    with connected(frames.append, faults={17: [fault]}) as (one, _):
        ask(one, READ, ANSWER)
        ask(one, READ, b"".join(adu for adu, _ in spoilt))
        ask(one, READ, ANSWER)
    answers = [(frame.adu, frame.unit) for frame in frames if frame.direction == "sent"]
    assert answers == [(ANSWER, 17), *spoilt, (ANSWER, 17)]
    assert frames[-1].function == 3


def test_a_delayed_answer_is_traced_when_it_is_sent(lan: Lan) -> None:
    frames: list[TracedFrame] = []
    server = Server(
        {17: made_device()}, faults={17: [Fault("delay", seconds=10)]}, trace=frames.append
    )
    with server.background("tcp://10.0.0.1:0") as running, lan.client(running.urls[0]) as talker:
        talker.send(READ + READ)
        lan.pass_time(5)
        assert [frame.direction for frame in frames] == ["received"] * 2
        lan.pass_time(10)
        assert [frame.direction for frame in frames] == ["received"] * 2 + ["sent"]


@pytest.mark.parametrize(
    ("scheme", "noise"),
    [
        ("tcp", bytes.fromhex("0001 0000 FFFF 11 03")),
        ("tcp", READ[:9]),
        ("udp", READ + b"!"),
        ("rtu+tcp", b"\x11\x03\x00\x00"),
        ("ascii+tcp", b":11030000"),
        ("ascii+tcp", b":11030000ZZ\r\n"),
    ],
)
def test_bytes_that_are_no_frame_are_traced(scheme: str, noise: bytes) -> None:
    frames: list[TracedFrame] = []
    with connected(frames.append, f"{scheme}://127.0.0.1:0") as (connection, _):
        connection.sendall(noise)
        if scheme != "udp":
            connection.shutdown(socket.SHUT_WR)
        until(lambda: frames)
    assert [(frame.adu, frame.unit, frame.function) for frame in frames] == [(noise, None, None)]


def test_silence_ends_an_incomplete_frame_in_the_trace() -> None:
    frames: list[TracedFrame] = []
    with connected(frames.append, "ascii+tcp://127.0.0.1:0") as (one, _):
        one.sendall(b":1103")
        until(lambda: frames)  # a second
        ask(one, ascii_frame("11 03 0000 0002"), ascii_frame("11 03 04 0007 0008"))
    assert said(frames)[0] == ("received", b":1103")
    assert len(frames) == 3


def test_the_trace_uses_a_changed_delimiter() -> None:
    frames: list[TracedFrame] = []
    change, restart = ascii_frame("11 08 0003 3B00"), ascii_frame("11 08 0001 0000")
    read, answer = ascii_frame("11 03 0000 0002"), ascii_frame("11 03 04 0007 0008")
    with connected(frames.append, "ascii+tcp://127.0.0.1:0") as (one, _):
        ask(one, change, change)
        ask(one, read[:-1] + b";", answer[:-1] + b";")
        ask(one, restart[:-1] + b";", restart[:-1] + b";")
        ask(one, read, answer)
    assert [frame.adu[-1:] for frame in frames] == [b"\n"] * 2 + [b";"] * 4 + [b"\n"] * 2
    assert {frame.unit for frame in frames} == {17}


def test_a_gateway_traces_frames_of_its_clients() -> None:
    frames: list[TracedFrame] = []
    with Server({5: made_device()}).background("tcp://127.0.0.1:0") as behind:
        gateway = Gateway([Route(behind.urls[0], "17", 5)], trace=frames.append)
        with gateway.background("tcp://127.0.0.1:0") as running, connect(running.urls[0]) as one:
            ask(one, READ, ANSWER)
    assert said(frames) == [("received", READ), ("sent", ANSWER)]
    assert {frame.endpoint for frame in frames} == set(running.urls)


def test_the_logger_of_the_wire_gets_the_traced_frames(caplog: pytest.LogCaptureFixture) -> None:
    with connected(None) as (one, url):
        ask(one, READ, ANSWER)
        assert not [record for record in caplog.records if record.name == "libmodbus_py.wire"]
        caplog.set_level(logging.DEBUG, "libmodbus_py.wire")
        with connect(url) as another:
            here = "{}:{}".format(*another.getsockname())
            ask(another, READ, ANSWER)
    lines = [record.getMessage() for record in caplog.records if record.name == "libmodbus_py.wire"]
    assert lines == [
        f"{url} {here} < unit 17, function 3: {READ.hex(' ')}",
        f"{url} {here} > unit 17, function 3: {ANSWER.hex(' ')}",
    ]


def test_tracing_begins_and_ends_while_the_server_runs() -> None:
    first: list[TracedFrame] = []
    second: list[TracedFrame] = []
    server = Server({17: made_device()})
    with (
        server.tracing(first.append),
        server.background("tcp://127.0.0.1:0") as running,
        connect(running.urls[0]) as one,
    ):
        ask(one, READ, ANSWER)
        with server.tracing(second.append):
            ask(one, READ, ANSWER)
        ask(one, READ, ANSWER)
    assert said(first) == [("received", READ), ("sent", ANSWER)] * 3
    assert said(second) == [("received", READ), ("sent", ANSWER)]
    with pytest.raises(TypeError, match="trace must be a function, not NoneType"):
        server.tracing(None)  # type: ignore[arg-type]


@pytest.mark.parametrize("error", [ValueError("mine"), GeneratorExit(), ModbusError("no")])
def test_a_trace_that_fails_costs_no_answer_and_is_logged_once(error, caplog) -> None:
    def broken(frame: TracedFrame) -> None:
        raise error

    with connected(broken) as (_, url):
        for _ in range(3):
            with connect(url) as one:
                ask(one, READ * 5, ANSWER * 5)
    assert [item.getMessage().endswith("this is logged once") for item in caplog.records] == [True]


@pytest.mark.parametrize("direction", ["received", "sent"])
@pytest.mark.parametrize("error", [SystemExit, KeyboardInterrupt])
def test_a_trace_that_ends_the_program_does_so_after_the_answers(error, direction) -> None:
    def ending(frame: TracedFrame) -> None:
        if frame.direction == direction:
            raise error("enough")

    def run() -> None:
        with connected(ending) as (one, _):
            ask(one, READ, ANSWER)
            assert one.recv(1) == b""

    with pytest.raises(error):
        run()


def test_a_slow_trace_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    def slow(frame: TracedFrame) -> None:
        time.sleep(0.11)

    with connected(slow) as (one, _):
        ask(one, READ, ANSWER)
    assert [record.getMessage()[:6] for record in caplog.records] == ["trace "]


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_a_trace_may_close_the_server(scheme: str) -> None:
    end = threading.Event()
    stack = ExitStack()

    def closing(frame: TracedFrame) -> None:
        stack.close()
        end.set()

    background: AbstractContextManager[Any]
    background = Server({17: made_device()}, trace=closing).background(f"{scheme}://127.0.0.1:0")
    running = stack.enter_context(background)
    with connect(running.urls[0]) as one:
        one.sendall(FRAMED[scheme]("11 03 0000 0002"))
        while one.recv(100):
            pass
    background.__exit__(None, None, None)  # the server's own thread could not wait for its end
    assert end.is_set()


def test_a_flood_takes_no_memory() -> None:
    """The server keeps nothing of what it passes to the callback."""
    latest: deque[TracedFrame] = deque(maxlen=10)
    with connected(latest.append) as (one, _):
        ask(one, READ * 100, ANSWER * 100)
        tracemalloc.start()
        try:
            for _ in range(30):
                ask(one, READ * 100, ANSWER * 100)
            size, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert size < 100_000


def test_answers_from_hooks_and_from_c_are_traced() -> None:
    """One unit is answered in C, the other by a hook's way."""
    frames: list[TracedFrame] = []
    units = {17: made_device(), 18: made_device(before_read=Hook(lambda access: None))}
    with connected(frames.append, units=units) as (one, _):
        ask(one, READ, ANSWER)
        ask(one, READ[:6] + b"\x12" + READ[7:], ANSWER[:6] + b"\x12" + ANSWER[7:])
    assert [frame.unit for frame in frames] == [17, 17, 18, 18]


HERE = "tcp://127.0.0.1:0"


class Failing(logging.Handler):
    """A handler that fails, as a full disk or a log server that is away makes it."""

    records = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.records += 1
        raise OSError("disk full")


@pytest.fixture
def log() -> Iterator[Failing]:
    """The handler that meets all that the package logs, at any level."""
    logger, handler = logging.getLogger("libmodbus_py"), Failing()
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    yield handler
    logger.removeHandler(handler)
    logger.setLevel(logging.NOTSET)


def fail(*_: object) -> Any:
    raise LookupError


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp"])
@pytest.mark.parametrize("hook", ["before_read", "before_write", "after_write", "authorize"])
def test_a_failing_log_of_a_hook_costs_no_answer(log: Failing, hook: str, scheme: str) -> None:
    server = Server(made_device(**{hook: fail}), trace=fail)
    with serving(scheme, server) as url, Client(url, timeout=5) as client:
        for _ in range(3):
            with pytest.raises(ServerDeviceFailure):
                client.read_write_registers(0, 1, 0, [1])
    assert log.records > 1


@pytest.mark.parametrize("authorize", [fail, lambda asked: False])
def test_a_refusal_of_a_gateway_is_answered(log: Failing, authorize: Any) -> None:
    with Server(made_device()).background(HERE) as behind:
        gateway = Gateway([Route(behind.urls[0])], authorize=authorize, trace=fail)
        with gateway.background(HERE) as running, Client(running.urls[0], timeout=5) as client:
            for _ in range(3):
                with pytest.raises((IllegalFunction, ServerDeviceFailure)):
                    client.read_holding_registers(0, 1)
    assert log.records > 1


def test_a_log_record_names_the_code_that_logged_it(caplog: pytest.LogCaptureFixture) -> None:
    made_device(before_read=fail).answer(b"\x03\x00\x00\x00\x01")
    (record,) = caplog.records
    assert (record.filename, record.funcName) == ("device.py", "_log_failure")
