"""Lines on which a byte takes longer than a computer keeps one back: no frame ends too soon."""

import pytest

from libmodbus_py import AsyncClient, Client, listen
from libmodbus_py.pdu import Diagnostics
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.protocol.framing import make_framer
from libmodbus_py.protocol.scan import pause_between_frames
from tests.simulation.lan import Lan, LineEnd
from tests.support.cases import each_case
from tests.support.driver import rtu
from tests.support.lan_server import unit_one

WRITE = rtu("01 06 0001 0003")
READ, ANSWER = rtu("01 03 0001 0001"), rtu("01 03 02 0000")

# Ends with a whole write to unit 1, up to its own CRC.
AROUND = rtu("02 10 0000 0004 08" + WRITE.hex())
LOOPBACK = rtu("01 08 0000" + WRITE.hex() + "0102")


@each_case(
    ("baudrate", "pause"),
    # 3.5 characters of 11 bits; fixed above 19200 bit/s (serial line, 2.5.1.1).
    [(300, 0.128333), (1200, 0.032083), (9600, 0.00401), (19200, 0.002005), (38400, 0.00175)],
)
def test_the_pause_between_frames_is_that_of_the_specification(baudrate: int, pause: float) -> None:
    assert pause_between_frames(baudrate) == pytest.approx(pause, abs=1e-6)
    endpoint = parse(f"rtu:///dev/line?baudrate={baudrate}")
    assert endpoint.pause == pause_between_frames(baudrate)


def test_the_pause_follows_the_bits_of_a_character() -> None:
    endpoint = parse("rtu:///dev/line?baudrate=1200&stop_bits=2")
    assert endpoint.pause == pytest.approx(3.5 * 12 / 1200)
    assert parse("rtu:///dev/line?baudrate=1200&parity=N").pause == pytest.approx(3.5 * 11 / 1200)
    assert parse("rtu+tcp://192.0.2.1").pause == 0


def test_framers_and_listeners_wait_for_the_pause() -> None:
    pause = pause_between_frames(300)
    for role in ("client", "server"):
        assert make_framer("rtu", role).quiet == pytest.approx(0.02)  # type: ignore[arg-type]
        framer = make_framer("rtu", role, pause)  # type: ignore[arg-type]
        assert framer.quiet == pytest.approx(pause + 0.02)
    assert listen.Separator("rtu", pause=pause).quiet == pytest.approx(pause + 0.02)
    assert listen.Separator("rtu").quiet == pytest.approx(0.02)


@pytest.mark.parametrize("is_gateway", [False, True])
@pytest.mark.parametrize("baudrate", [300, 600, 1200, 9600])
def test_no_part_of_a_frame_is_executed(lan: Lan, baudrate: int, is_gateway: bool) -> None:
    with unit_one(f"rtu:///dev/line?baudrate={baudrate}", is_gateway=is_gateway) as (_, writes):
        lan.line("/dev/line").character = 11 / baudrate
        master = LineEnd(lan.line("/dev/line"))
        for frame, answer in ((AROUND, b""), (LOOPBACK, LOOPBACK), (READ, ANSWER)):
            master.heard = b""
            for byte in frame:  # one by one, as they come out of a slow port
                master.write(bytes([byte]))
                lan.pass_time(11 / baudrate)
            lan.pass_time(5)
            assert master.heard == answer
    assert writes == []


def test_a_listener_hears_whole_frames() -> None:
    """At 300 bit/s, a byte comes after 37 ms."""
    separator = listen.Separator("rtu", pause=pause_between_frames(300))
    at, exchanges = 0.0, []
    for frame in (AROUND, rtu("02 10 0000 0004"), READ, ANSWER):
        for byte in frame:
            at += 11 / 300
            exchanges += separator.feed(bytes([byte]), at)
        at += 0.3
        exchanges += separator.tick(at)
    assert [(item.kind, item.function) for item in exchanges] == [("answered", 16), ("answered", 3)]


@pytest.mark.parametrize("is_async", [False, True])
def test_a_client_receives_a_slow_answer_completely(lan: Lan, is_async: bool) -> None:
    """It is the answer of a unit to a loopback, whose data begin with a CRC that fits."""
    data = rtu("01 08 0000")[-2:] + WRITE
    line = "rtu:///dev/line?baudrate=300"
    whole = rtu("01 08 0000" + data.hex())
    unit = SlowUnit(lan, whole)
    if is_async:

        async def ask() -> bytes:
            async with AsyncClient(line, unit=1, timeout=10) as plc:
                return await plc.execute(Diagnostics(0, data))

        assert lan.wait(ask()) == data
    else:
        with Client(line, unit=1, timeout=10) as plc:
            assert plc.execute(Diagnostics(0, data)) == data
    assert unit.heard == whole


class SlowUnit(LineEnd):
    """Answers the first request, a byte at a time."""

    is_unit = True

    def __init__(self, lan: Lan, answer: bytes) -> None:
        super().__init__(lan.line("/dev/line"))
        self._lan = lan
        self._answer = answer

    def hear(self, data: bytes) -> None:
        super().hear(data)
        for number, byte in enumerate(self._answer, 1):
            at = self._lan.events.now + 0.2 + number * 11 / 300
            self._lan.events.at(at, super().write, bytes([byte]))
