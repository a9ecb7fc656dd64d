"""
Captures: bytes that tshark was seen to decode without options, read again, and hostile files.

`decoded.pcapng` is what a listener wrote of all worked examples and three damaged pieces; tshark
4.0.17 decodes 94 of 94 queries and responses as Modbus/TCP, none
of them malformed. What is damaged it hands to Modbus RTU, which shows these three as bytes, for
they do not even look like frames.
"""

import asyncio
import contextlib
import itertools
import os
import random
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.listen import CaptureError, Transaction, listen
from libmodbus_py.tools.listener.capture import CaptureWriter
from libmodbus_py.tools.listener.transaction import TimedFrame
from tests.support.cases import each_case
from tests.support.vectors import EXCEPTIONS, RESPONSES, exchanges

DECODED = Path(__file__).with_name("decoded.pcapng")

DAMAGED = [b"\x01\x03\x00", b"\xff", bytes(range(200))]


def conversation() -> Iterator[TimedFrame]:
    """All worked examples, each answer 4 ms behind its question, and damaged bytes between."""
    requests = {answer.id: question for question, answer in exchanges()}
    at = 1_700_000_000.0
    for number, answer in enumerate([*RESPONSES, *EXCEPTIONS]):
        if answer.id in requests:
            yield TimedFrame(at, at, "request", requests[answer.id].frame)
            yield TimedFrame(at + 0.004, at + 0.004, "response", answer.frame)
        at += 0.5
        if number < len(DAMAGED):
            yield TimedFrame(at, at, "damage", None, DAMAGED[number])
        at += 0.5


def write(path: Path, *links: int) -> Path:
    writer = CaptureWriter(path, "rtu:///dev/ttyUSB0?baudrate=19200")
    for packet in conversation():
        for link in links or (0,):
            writer.write(packet, link)
    writer.close()
    return path


def read(path: Path) -> list[Transaction]:
    with listen(str(path)) as line:
        return list(line)


def block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", 12 + len(body))
    return struct.pack("<I", kind) + size + body + size


class TestWriter:
    def test_the_bytes_are_those_that_tshark_decodes(self, tmp_path: Path) -> None:
        assert write(tmp_path / "x.pcapng").read_bytes() == DECODED.read_bytes()


class TestReader:
    def test_a_capture_has_the_blocks_of_pcapng(self, tmp_path: Path) -> None:
        result = read(write(tmp_path / "x.pcapng"))
        good = [entry for entry in result if entry.kind in ("answered", "exception")]
        assert len(good) == len(exchanges())
        bad = [entry for entry in result if entry not in good]
        assert [entry.error and entry.error.received for entry in bad] == DAMAGED
        for entry in good:
            assert entry.duration == pytest.approx(0.004, abs=1e-5)

    def test_connections_are_distinguished(self, tmp_path: Path) -> None:
        alone = read(write(tmp_path / "1.pcapng"))
        three = read(write(tmp_path / "3.pcapng", 1, 2, 300))
        assert len(three) == 3 * len(alone)
        assert {entry.kind for entry in three} == {entry.kind for entry in alone}

    def test_a_capture_saved_again_by_wireshark_is_read(self, tmp_path: Path) -> None:
        """With nanoseconds, blocks of its own, and another capture behind it."""
        options = struct.pack("<HHB3xHH", 9, 1, 9, 0, 0)
        section = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
        interface = block(1, struct.pack("<HHI", 252, 0, 0) + options)
        packets = DECODED.read_bytes()[92:296]  # the first two
        file = tmp_path / "x.pcapng"
        file.write_bytes(2 * (section + interface + block(5, bytes(20)) + packets))
        (first, second) = read(file)
        assert (first.kind, first.time) == (second.kind, second.time) == ("answered", 1_700_000.0)
        assert first.duration == pytest.approx(4e-6, rel=0.01)

    @each_case(
        ("change", "what"),
        [
            (lambda data: b"", "no pcapng or pcap file"),
            (lambda data: b"not a capture at all", "no pcapng or pcap file"),
            (lambda data: data[:-1], "the file ends inside a block"),
            (lambda data: data[:50], "the file ends inside a block"),
            (lambda data: data[:4] + b"\xff\xff\xff\x7f" + data[8:], "a block of 2147483647"),
            (lambda data: data[:4] + b"\x1d" + data[5:24] + b"\x1d" + data[25:], "a block of 29"),
            (lambda data: data[:24] + b"\0\0\0\0" + data[28:], "two lengths differ"),
            (lambda data: data[:36] + b"\x93\0" + data[38:], "link type 147, not 0, 1, "),
            (lambda data: data.replace(b"mbtcp", b"mbxxx"), "neither mbtcp nor mbrtu"),
        ],
    )
    def test_other_files_are_refused(self, tmp_path: Path, change: object, what: str) -> None:
        file = tmp_path / "x.pcapng"
        assert callable(change)
        file.write_bytes(change(DECODED.read_bytes()))
        with pytest.raises(CaptureError, match=what) as caught:
            read(file)
        assert str(caught.value).startswith(str(file))

    @each_case("seed", range(40))
    def test_damaged_files_are_read_or_refused(self, tmp_path: Path, seed: int) -> None:
        """They are read or refused, and nothing else."""
        choose = random.Random(seed)
        file = tmp_path / "x.pcapng"
        for _ in range(25):
            data = bytearray(DECODED.read_bytes())
            for _ in range(choose.randint(1, 30)):
                data[choose.randrange(len(data))] = choose.choice(
                    [0, 1, 255, choose.randrange(256)]
                )
            file.write_bytes(data)
            try:
                for packet in read(file):
                    str(packet)
            except CaptureError as error:
                assert "\n" not in str(error)  # noqa: PT017  # either is right

    def test_a_loop_runs_other_tasks_while_a_capture_is_read(self) -> None:
        async def read_all() -> tuple[int, int]:
            turns = count = 0

            async def take_turns() -> None:
                nonlocal turns
                while True:
                    turns += 1
                    await asyncio.sleep(0)

            other = asyncio.create_task(take_turns())
            async with listen(str(DECODED)) as line:
                async for _ in line:
                    count += 1
            other.cancel()
            return turns, count

        turns, count = asyncio.run(read_all())
        assert turns >= count > 40

    def test_no_existing_file_is_overwritten(self, tmp_path: Path) -> None:
        file, other = write(tmp_path / "x.pcapng"), tmp_path / "other"
        other.write_text("kept")
        for capture in (file, other):
            with pytest.raises(ValueError, match="exists, and would be overwritten"):
                listen(str(file), capture=capture)
        assert (file.read_bytes(), other.read_text()) == (DECODED.read_bytes(), "kept")

    def test_a_capture_may_be_written_to_a_pipe(self, tmp_path: Path) -> None:
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        reads = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        try:
            write(pipe)
            assert os.read(reads, 1 << 16) == DECODED.read_bytes()
        finally:
            os.close(reads)

    def test_a_pipe_without_a_reader_is_refused(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(ValueError, match="a pipe, and no program reads it"):
            write(tmp_path / "pipe")

    def test_a_pipe_that_is_full_ends_the_capture(self, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr("libmodbus_py.tools.listener.capture.READER_TIME_S", 0.01)
        os.mkfifo(tmp_path / "pipe")
        reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
        writer = CaptureWriter(tmp_path / "pipe", "a")

        def fill() -> None:
            for packet in itertools.chain.from_iterable(conversation() for _ in range(99)):
                writer.write(packet)

        with (
            contextlib.closing(os.fdopen(reader, "rb")),
            contextlib.closing(writer),
            pytest.raises(OSError, match="has stopped reading"),
        ):
            fill()

    def test_a_capture_of_a_capture_is_equal(self, tmp_path: Path) -> None:
        copy = tmp_path / "copy.pcapng"
        with listen(str(DECODED), capture=copy) as line:
            first = list(line)
        assert [str(packet) for packet in read(copy)] == [str(entry) for entry in first]

    def test_a_missing_file_is_an_error(self) -> None:
        with pytest.raises(FileNotFoundError):
            listen("nowhere.pcapng")


def test_a_tap_continues_after_its_capture_failed(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    path, device = tmp_path / "x.pcapng", Device(Mapping(holding_registers={0: [7]}))
    with (
        Server(device).background("rtu+tcp://127.0.0.1:0") as running,
        listen("rtu+tcp://127.0.0.1:0", between=running.urls[0], capture=path) as line,
        Client(line.url, unit=1) as client,
    ):
        assert line._writer is not None
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, line._writer._file.fileno())
        os.close(full)
        for _ in range(3):
            assert client.read_holding_registers(0, 1) == [7]
            assert next(line).response == [7]
        assert line.capture_error is not None
        assert line.capture_error.filename == str(path)
    messages = [record.getMessage() for record in caplog.records if "ends here" in record.message]
    assert messages == [f"{path}: No space left on device; the capture ends here"]
