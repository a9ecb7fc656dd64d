"""
A disk that becomes full while traffic is recorded: the capture ends, and the line goes on.
"""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Context, Device, Mapping, Server
from libmodbus_py.listen import Listener, listen
from tests.support.commands import Started
from tests.support.talk import rtu
from tests.tools.listener.shared_line import SharedLine

ASKED = rtu("01 03 00 00 00 01") + rtu("01 03 02 00 07")


@pytest.fixture
def target() -> Iterator[str]:
    with Server(Device(Mapping(holding_registers={0: [7]}))).background(
        "rtu+tcp://127.0.0.1:0"
    ) as running:
        yield running.urls[0]


def fill_disk(line: Listener) -> None:
    """Let the open capture be written to /dev/full from now on."""
    assert line._writer is not None
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, line._writer._file.fileno())
    os.close(full)


def check_end(line: Listener, path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert line.capture_error is not None
    assert line.capture_error.filename == str(path)
    told = [each.getMessage() for each in caplog.records if "ends here" in each.message]
    assert told == [f"{path}: No space left on device; the capture ends here"]


def test_a_tap_goes_on(target: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "x.pcapng"
    with (
        listen("rtu+tcp://127.0.0.1:0", between=target, capture=path) as line,
        Context.from_url(line.url, unit=1) as client,
    ):
        fill_disk(line)
        for _ in range(3):
            assert client.read_holding_registers(0, 1) == [7]
            assert next(line).response == [7]
        check_end(line, path, caplog)


def test_listening_on_a_line_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "x.pcapng"
    with (
        SharedLine("listener") as bus,
        listen(f"rtu://{bus.paths['listener']}", capture=path) as line,
    ):
        fill_disk(line)
        for _ in range(3):
            bus.say(ASKED)
            assert next(line).response == [7]
        check_end(line, path, caplog)


def test_reading_a_capture_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read = Path(__file__).parent / "decoded.pcapng"
    with listen(str(read)) as line:
        wanted = list(map(str, line))
    path = tmp_path / "x.pcapng"
    with listen(str(read), capture=path) as line:
        fill_disk(line)
        assert list(map(str, line)) == wanted
        check_end(line, path, caplog)


@pytest.mark.parametrize("size", range(330, 420, 15))
def test_what_was_written_can_be_read(size: int, target: str, tmp_path: Path) -> None:
    """Whichever byte is the last that the disk takes. The command says that all is not there."""
    path = tmp_path / "x.pcapng"
    arguments = ("rtu+tcp://127.0.0.1:0", "--between", target, "--capture", path)
    with Started("listen", *arguments) as made:
        url = made.stderr.readline().removeprefix("listening on ").rstrip("\n")
        resource.prlimit(made.pid, resource.RLIMIT_FSIZE, (size, size))
        with Context.from_url(url, unit=1) as client:
            for _ in range(4):
                assert client.read_holding_registers(0, 1) == [7]
                assert "-> [7]" in made.stdout.readline()
        made.send_signal(signal.SIGINT)
        _, errors = made.communicate()
    assert made.returncode == 1
    assert errors == f"{path}: File too large; the capture ends here\n"
    assert path.stat().st_size <= size
    with listen(str(path)) as line:
        kinds = [each.kind for each in line]
    assert "answered" in kinds
    assert len(kinds) < 4
