"""What is particular to serial lines: silence, echo, direction control, settings."""

import fcntl
import re
import subprocess
import sys
import termios
import time
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    FrameError,
    Mapping,
    ModbusError,
    Server,
    State,
    framing,
    pdu,
)
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.c_programs import SOURCES, compile_c
from tests.support.clients import ALL, Connect, asking, read
from tests.support.driver import ASCII, LINE, Driver, ascii_frame, kinds, rtu
from tests.support.peers import FakeUnit, answer
from tests.support.replies import exchange
from tests.support.transports import serving

ANSWER = framing.RtuFramer("server").encode(framing.Frame(1, b"\x03\x02\x00\x07"))


def test_a_server_answers_after_the_silence(device: Device) -> None:
    with (
        SerialWire() as wire,
        Server({17: device}).background(f"rtu://{wire.server}?silence=0.05"),
        Client(f"rtu://{wire.client}", unit=17) as context,
    ):
        for _ in range(3):
            start = time.monotonic()
            assert context.read_holding_registers(100, 1) == [1000]
            assert time.monotonic() - start >= 0.05


def with_echo(request: bytes) -> list[bytes]:
    if request.startswith(b":"):
        framer = framing.AsciiFramer()
        return [request, framer.encode(framing.Frame(1, b"\x03\x02\x00\x07"))]
    return [request, ANSWER]


def test_an_expected_echo_that_does_not_come_changes_nothing(connect: Connect) -> None:
    with (
        FakeUnit(lambda request: [ANSWER]) as unit,
        connect(f"rtu://{unit.path}?echo=1&timeout=0.2") as context,
    ):
        for _ in range(3):
            try:
                assert context.read_holding_registers(0, 1) == [7]
            except ModbusError:
                pytest.fail("the answer begins like the request, and was taken for its echo")


RTS = """
from libmodbus_py import *
context = {make}
for _ in range(2):
    context.read_holding_registers(0, 1)
"""


def step(line: str) -> str:
    """RTS set, RTS cleared, request written, or nothing of these, in a line of strace."""
    if "TIOCMBIS" in line or ("TIOCMSET, [" in line and "TIOCM_RTS" in line):
        return "set "
    if "TIOCMBIC" in line or "TIOCMSET, [" in line:
        return "cleared "
    return "written " if re.search(r'write\(\d+, "(\\1\\3|:0103)', line) else ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "way"), [("up", "set written cleared"), ("down", "cleared written set")]
)
@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_rts_is_set_while_a_request_is_sent(tmp_path, mode, way, kind) -> None:
    """A pty has no RTS, so the system calls themselves are looked at."""
    answer = with_echo(b":")[1] if kind == "ascii" else ANSWER
    with FakeUnit(lambda request: [answer]) as unit:
        options = f"baudrate=115200, rs485='rts-{mode}'"
        make = f"Client('{kind}://{unit.path}', {options})"
        trace = tmp_path / "trace"
        modem_lines = compile_c(SOURCES / "rts.c", tmp_path / "rts.so", "-shared", "-fPIC")
        watch = ["strace", "-f", "-e", "trace=ioctl,write", "-o", str(trace)]
        watch += ["-E", f"LD_PRELOAD={modem_lines}"]
        program = [sys.executable, "-c", RTS.format(make=make)]
        subprocess.run([*watch, *program], check=True, timeout=60)
    steps = "".join(step(line) for line in trace.read_text().splitlines())
    assert steps.count(way) == 2


@pytest.mark.parametrize(
    "query",
    [
        "baudrate=115200&parity=N&stop_bits=2&data_bits=8",
        "baudrate=9600&parity=O&silence=0.001",
        "rs485=rts-up&rts_delay=0.001",
    ],
)
def test_settings_in_the_url_reach_the_port(device: Device, query: str) -> None:
    with (
        SerialWire() as wire,
        Server({17: device}).background(f"rtu://{wire.server}?{query}"),
        Client(f"rtu://{wire.client}?{query}", unit=17) as context,
    ):
        for _ in range(3):
            assert context.read_holding_registers(100, 1) == [1000]


@ALL
@pytest.mark.parametrize("scheme", ["ascii+tcp", "ascii"])
def test_an_accepted_delimiter_is_followed_and_a_restart_ends_it(scheme: str, kind: str) -> None:
    server = Server(Device(Mapping(holding_registers=10)))
    with serving(scheme, server) as url, asking(kind, url) as client:
        client.write_register(3, 42)
        client.diagnostics(3, 0x2100)
        assert read(client, 3) == 42
        client.diagnostics(3, 0x2400)
        assert read(client, 3) == 42
        with pytest.raises(ModbusError):  # a colon ends nothing
            client.diagnostics(3, 0x3A00)
        assert read(client, 3) == 42
        client.diagnostics(1)
        assert read(client, 3) == 42


@ALL
@pytest.mark.parametrize("in_url", [True, False])
def test_a_delimiter_that_the_device_has_already_is_an_option(in_url: bool, kind: str) -> None:
    def with_dollar(request: bytes) -> list[bytes]:
        assert request.endswith(b"\r$")
        return [answer(request, "ascii")[:-1] + b"$"]

    query, options = ("&delimiter=0x24", {}) if in_url else ("", {"delimiter": 0x24})
    with (
        FakeUnit(with_dollar) as unit,
        asking(kind, f"ascii://{unit.path}?baudrate=115200{query}", **options) as client,
    ):
        assert read(client, 3) == 3


@ALL
def test_a_byte_right_after_a_flush_does_not_reopen_the_port(kind: str, monkeypatch) -> None:
    """As a line picks up while nobody talks; each opening locks the port."""
    lock, flush, locks = fcntl.flock, termios.tcflush, []

    def counted(*args: Any) -> None:
        locks.append(args)
        lock(*args)

    def followed(*args: Any) -> None:
        flush(*args)
        unit.write(b"\x00")
        time.sleep(0.002)

    monkeypatch.setattr(fcntl, "flock", counted)
    with (
        FakeUnit(lambda request: [answer(request, "rtu")]) as unit,
        asking(kind, f"rtu://{unit.path}?baudrate=115200") as client,
    ):
        monkeypatch.setattr(termios, "tcflush", followed)
        for address in range(10):
            unit.write(b"\x00")
            time.sleep(0.003)
            assert read(client, address) == address
        assert len(locks) == 1
        assert client.state is State.CONNECTED
        assert client.statistics.lost == 0


def test_an_accepted_delimiter_is_used_until_a_restart() -> None:
    driver = Driver(ASCII)
    driver.ask(pdu.Diagnostics(3, b"#\0"))
    assert driver.sent[-1] == b":010800032300D1\r\n"
    driver.come(b":010800032300D1\r\n")
    batch = driver.ask(1)
    assert driver.sent[-1].endswith(b"\r#")
    driver.come(ascii_frame("01 03 02 0001", b"\r#"))
    assert batch.outcomes == [[1]]
    driver.ask(pdu.Diagnostics(1, b"\0\0"))
    driver.come(ascii_frame("01 08 0001 0000", b"\r#"))
    driver.ask(1)
    assert driver.sent[-1].endswith(b"\r\n")


def test_a_refused_delimiter_is_not_used() -> None:
    driver = Driver(ASCII, delimiter=0x24)
    driver.ask(pdu.Diagnostics(3, b":\0"))
    driver.come(ascii_frame("01 88 03", b"\r$"))
    driver.ask(1)
    assert driver.sent[-1].endswith(b"\r$")


@pytest.mark.parametrize("data", [b":\0", b"\r\0", b"A\0", b"\xff\0", b"#\n"])
def test_a_delimiter_that_no_frame_can_have_is_not_used_if_a_device_echoes_it(data: bytes) -> None:
    driver = Driver(ASCII)
    batch = driver.ask(pdu.Diagnostics(3, data))
    driver.come(ascii_frame("01 08 0003" + data.hex()))
    assert batch.outcomes == [data]
    driver.lose()
    driver.open()  # with another framer
    batch = driver.ask(1, unit=2)
    assert driver.sent[-1].endswith(b"\r\n")
    driver.come(ascii_frame("02 03 02 0001"))
    assert batch.outcomes == [[1]]


def test_an_rtu_line_has_no_delimiter() -> None:
    driver = Driver(LINE)
    driver.ask(pdu.Diagnostics(3, b"#\0"))
    driver.come(rtu("01 08 0003 2300"))
    exchange(driver, 1)


def test_a_damaged_answer_ends_the_wait_at_once() -> None:
    """Of ASCII, whose frames have an end: nothing more of it will come."""
    driver = Driver(ASCII, timeout=5)
    for frame in (b":0103020005F6\r\n", b":01030200zz\r\n", b":0183\r\n"):
        batch = driver.ask(5)
        driver.come(frame)
        assert kinds(batch) == [FrameError], frame
        assert batch.outcomes[0].received == frame
        driver.wait(11)


def test_noise_is_no_damaged_answer() -> None:
    driver = Driver(ASCII, timeout=5)
    batch = driver.ask(5)
    driver.come(b":7703020005F6\r\n")
    assert not batch.is_done
    driver.come(ascii_frame("01 03 02 0005"))
    assert batch.outcomes == [[5]]
