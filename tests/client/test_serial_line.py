"""
What is particular to serial lines: silence, echo, direction control, settings.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from libmodbus_py import Context, Device, ModbusError, RtuContext, Server, framing
from libmodbus_py.testing.wires import SerialWire
from tests.support.c_programs import SOURCES, compile_c
from tests.support.clients import Connect
from tests.support.fake import FakeUnit

ANSWER = framing.RtuFramer("server").encode(framing.Frame(1, b"\x03\x02\x00\x07"))


def test_a_server_answers_after_the_silence(device: Device) -> None:
    with (
        SerialWire() as wire,
        Server({17: device}).background(f"rtu://{wire.server}?silence=0.05"),
        RtuContext(wire.client, unit=17) as context,
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


@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_echo_is_taken_out_of_what_is_received(connect: Connect, kind: str) -> None:
    with (
        FakeUnit(with_echo) as unit,
        connect(f"{kind}://{unit.path}?echo=1&timeout=0.5") as context,
    ):
        for _ in range(5):
            assert context.read_holding_registers(0, 1) == [7]


def test_echo_in_one_piece_with_the_answer_is_taken_out(connect: Connect) -> None:
    with (
        FakeUnit(lambda request: [request[:3], request[3:] + ANSWER[:2], ANSWER[2:]]) as unit,
        connect(f"rtu://{unit.path}?echo=1&timeout=0.5") as context,
    ):
        for _ in range(3):
            assert context.read_holding_registers(0, 1) == [7]


def test_no_echo_where_one_was_announced_does_no_harm(connect: Connect) -> None:
    with (
        FakeUnit(lambda request: [ANSWER]) as unit,
        connect(f"rtu://{unit.path}?echo=1&timeout=0.2") as context,
    ):
        for _ in range(3):
            try:
                assert context.read_holding_registers(0, 1) == [7]
            except ModbusError:
                pytest.fail("the answer begins like the request, and was taken for its echo")


def test_a_server_does_not_take_the_echo_of_its_answer_for_a_request(device: Device) -> None:
    """The echo of a write's answer is a good request: without the option it would be answered."""
    with (
        SerialWire() as wire,
        Server({17: device}).background(f"rtu://{wire.server}?echo=1&baudrate=115200"),
        RtuContext(wire.client, 115200, unit=17, timeout=0.3) as context,
    ):
        context.connect()
        port = context._driver._port
        request = framing.RtuFramer("server").encode(framing.Frame(17, b"\x06\x00\x64\x00\x01"))
        for _ in range(3):
            wire.clear()
            port.send([request], time.monotonic())
            answer = b""
            while len(answer) < len(request):
                answer += b"".join(port.receive())
            port.send([answer], time.monotonic())  # as the transceiver would
            time.sleep(0.1)
            assert port.receive() == []


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


@pytest.mark.parametrize(
    ("mode", "expected"), [("up", "set written cleared"), ("down", "cleared written set")]
)
@pytest.mark.parametrize("kind", ["native", "python", "ascii"])
def test_rts_is_turned_while_a_request_goes_out(
    tmp_path: Path, mode: str, expected: str, kind: str
) -> None:
    """A pty has no RTS, so the system calls themselves are looked at."""
    answer = with_echo(b":")[1] if kind == "ascii" else ANSWER
    with FakeUnit(lambda request: [answer]) as unit:
        options = f"{unit.path!r}, 115200, rs485='rts-{mode}'"
        make = {
            "native": f"RtuContext({options}, native=True)",
            "python": f"RtuContext({options}, native=False)",
            "ascii": f"AsciiContext({options})",
        }[kind]
        trace = tmp_path / "trace"
        modem_lines = compile_c(SOURCES / "rts.c", tmp_path / "rts.so", "-shared", "-fPIC")
        watch = ["strace", "-f", "-e", "trace=ioctl,write", "-o", str(trace)]
        watch += ["-E", f"LD_PRELOAD={modem_lines}"]
        program = [sys.executable, "-c", RTS.format(make=make)]
        subprocess.run([*watch, *program], check=True, timeout=60)
    steps = "".join(step(line) for line in trace.read_text().splitlines())
    assert steps.count(expected) == 2


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
        Context.from_url(f"rtu://{wire.client}?{query}", unit=17) as context,
    ):
        for _ in range(3):
            assert context.read_holding_registers(100, 1) == [1000]
