"""The messages that the page on troubleshooting explains are those a client makes of such lines."""

import os
import pty
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from libmodbus_py import Client, ModbusError
from libmodbus_py.ports.serial_devices import open_devices, users_of
from tests.docs.conftest import Isolated
from tests.docs.documents import ROOT
from tests.docs.python_blocks import matches
from tests.support.driver import ascii_frame, rtu
from tests.support.peers import FakeServer, FakeUnit, mbap, mute_port, refusing, url_of

PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
NAMED = re.findall(r"^\| `(.*?)` \|", PAGE, re.MULTILINE)

ANSWER = "11 03 06 022B 0000 0064"  # registers 555, 0 and 100 of unit 17
GOOD, LATE = rtu(ANSWER), rtu("11 03 06 0001 0000 0064")

# Received bytes -> the error of the client.
Came = Callable[[bytes], bytes]
RTU: dict[str, Came] = {
    "no answer within 0.3 s": lambda request: b"",
    "no complete answer within 0.3 s, but 11 03 06 02 2b": lambda request: GOOD[:5],
    "bytes without a fitting CRC": lambda request: GOOD[:-1] + b"\0",
    "bytes without a fitting CRC; only noise; baud rate, parity, A and B swapped?": (
        lambda request: bytes.fromhex("00 FE 00 FE FC")
    ),
    "no complete answer within 0.3 s, but 11 03 00 6b 00 03 76 87; "
    "the request itself came back; echo=True?": lambda request: request,
    "this looks like ascii://": lambda request: ascii_frame(ANSWER),
    "unit 18 answered": lambda request: rtu("12 03 06 022B 0000 0064"),
    "function 4 was answered, not 3": lambda request: rtu("11 04 06 022B 0000 0064"),
    "two answers came, one to an earlier request": lambda request: GOOD + LATE,
    "answered with a response of 5 bytes: 03 00 02 17 81": lambda request: rtu("11 03 0002 1781"),
    "answered with 4 bytes of data": lambda request: rtu("11 03 04 022B 0000"),
}
ASCII: dict[str, Came] = {"this looks like rtu://": lambda request: GOOD}
TCP: dict[str, Came | None] = {
    "closed by the other side; nothing was answered yet; does it want tls://?": None,
    "this looks like rtu+tcp://": lambda request: GOOD,
    "this looks like tls://": lambda request: bytes.fromhex("15 0301 0002 0228"),
    "header with length 12081, not 2..254": lambda request: b"HTTP/1.1 400 Bad Request\r\n\r\n",
    'unit 255 answered; accept_unit="any" would take it': (
        lambda request: mbap(request, bytes.fromhex("0306022B00000064"), unit=255)
    ),
    ': id 77, not 1; ids="ignore" would take it': (
        lambda request: mbap(request, bytes.fromhex("0306022B00000064"), transaction=77)
    ),
}


REFUSED: dict[str, Came] = {
    f"{name} (exception {code})": lambda request, code=code: mbap(request, bytes([0x83, code]))
    for name, code in {
        "illegal function": 1,
        "illegal data address": 2,
        "illegal data value": 3,
        "server device failure": 4,
        "server device busy": 6,
        "gateway path unavailable": 10,
        "gateway target device failed to respond": 11,
    }.items()
}
LINE: dict[str, Came] = {
    "this looks like tcp://": lambda request: bytes.fromhex(f"000100000009{ANSWER}")
}
OTHERS = {
    "cannot open /dev/ttyUSB0: No such file or directory",
    "cannot open /dev/ttyUSB0: Permission denied; is this user in the group dialout?",
    "cannot open /dev/ttyUSB0: in use by minicom (77)",
    "cannot open /dev/ttyUSB0: in use by this program itself; "
    "one client (with for_unit) or context reaches all units",
    "cannot open /dev/ttyUSB0: not a serial port",
    "cannot open /dev/ttyS1: the system has no hardware for this port",
    "cannot open /dev/ttyUSB0: baudrate 230400 refused: the port does 9600, and at most 115200",
    "Connection refused",
    "Connection timed out",
    "cannot resolve host 'no-such-host.invalid'",
    "no device has connected to 127.0.0.1:1502",
    "count must be in 1..125, not 126",
    "address must be in 0..65535, not 65536",
}


def output(url: str, address: int = 107, count: int = 3) -> str:
    with (
        pytest.raises((ModbusError, ValueError)) as caught,
        Client(url, unit=17, timeout=0.3) as plc,
    ):
        plc.read_holding_registers(address, count)
    return str(caught.value)


def ends_so(message: str, text: str) -> bool:
    return matches(f"...{message}", text)


def test_a_test_causes_each_message_of_the_page() -> None:
    assert {*NAMED} == {*RTU, *ASCII, *TCP, *LINE, *OTHERS}


@pytest.mark.parametrize(
    ("scheme", "message", "came"),
    [("rtu", *case) for case in RTU.items()] + [("ascii", *case) for case in ASCII.items()],
)
def test_errors_on_a_line_are_those_of_the_page(scheme: str, message: str, came: Came) -> None:
    with FakeUnit(lambda request: [came(request)]) as unit:
        assert ends_so(message, output(f"{scheme}://{unit.path}"))


@pytest.mark.parametrize(
    ("scheme", "message", "came"),
    [("tcp", *case) for case in [*TCP.items(), *REFUSED.items()]]
    + [("rtu+tcp", *case) for case in LINE.items()]
    + [("tcp", "no answer within 0.3 s", lambda request: b"")],
)
def test_network_errors_are_those_of_the_page(scheme: str, message: str, came: Came | None) -> None:
    with FakeServer(came and (lambda request: [came(request)])) as server:
        assert ends_so(message, output(f"{scheme}://127.0.0.1:{server.port}"))


HOLD = """
from libmodbus_py import Client
plc = Client({!r})
plc.connect()
print("held", flush=True)
input()
"""


def port(path: str, number: int) -> str:
    return str(NAMED[number]).replace("/dev/ttyUSB0", path)


def open_pseudo_terminal(name: str) -> list[int]:
    """Open pseudo-terminals until one has this name; return this process and all descriptors."""
    opened = [*pty.openpty()]
    while os.ttyname(opened[-1]) != name:
        opened += pty.openpty()
    return [os.getpid(), *opened]


def close_all(descriptors: list[int]) -> None:
    for descriptor in descriptors:
        os.close(descriptor)


def test_a_pseudo_terminal_in_another_namespace_is_another_port(isolated: Isolated) -> None:
    with FakeUnit(lambda request: []) as unit:
        process, *descriptors = isolated(open_pseudo_terminal, unit.path)
        assert unit.path in [user.path for user in open_devices()[0] if user.process == process]
        assert process not in [user.process for user in users_of(unit.path)]
        isolated(close_all, descriptors)


def test_errors_of_ports_are_those_of_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    assert ends_so(port("/dev/no-such-port", 0), output("rtu:///dev/no-such-port"))
    assert ends_so(port("/dev/null", 4), output("rtu:///dev/null"))
    with FakeUnit(lambda request: []) as unit:
        url = f"rtu://{unit.path}"
        hold = HOLD.format(url)
        with subprocess.Popen(
            [sys.executable, "-c", hold], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as other:
            assert other.stdout is not None
            assert other.stdin is not None
            assert other.stdout.readline() == b"held\n"
            name = Path(f"/proc/{other.pid}/comm").read_text("utf-8").strip()
            text = port(unit.path, 2).replace("minicom (77)", f"{name} ({other.pid})")
            assert ends_so(text, output(url))
            other.stdin.write(b"\n")
        with Client(url):
            assert ends_so(port(unit.path, 3), output(url))

        def refuse(*_: object) -> int:
            raise PermissionError(13, "Permission denied")  # which root never sees

        monkeypatch.setattr(os, "open", refuse)
        text = output(url)
        monkeypatch.undo()
        assert ends_so(port(unit.path, 1), text)


def test_errors_of_hosts_are_those_of_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    with refusing() as bound, mute_port() as mute:
        url = url_of(bound)
        assert ends_so("Connection refused", output(url))
        assert ends_so("Connection timed out", output(f"tcp://127.0.0.1:{mute}"))
    assert ends_so(f"no device has connected to {url[6:]}", output(f"listen+{url}"))

    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")  # nobody is asked

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    assert matches(
        "...cannot resolve host 'no-such-host.invalid'...", output("tcp://no-such-host.invalid")
    )


def test_arguments_are_checked_before_anything_is_sent() -> None:
    with FakeServer(None) as server:
        assert ends_so("count must be in 1..125, not 126", output(server.url, 0, 126))
        assert ends_so("address must be in 0..65535, not 65536", output(server.url, 65536, 1))
        assert server.requests == []
