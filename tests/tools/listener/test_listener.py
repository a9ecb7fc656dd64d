"""Listening for real: a line of pseudo-terminals, others' programs on it, and a tap between."""

import asyncio
import importlib
import logging
import os
import signal
import socket
import stat
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from libmodbus_py import (
    Client,
    Device,
    IllegalDataAddress,
    Mapping,
    ModbusConnectionError,
    Server,
    pdu,
)
from libmodbus_py.listen import Listener, Transaction, listen
from libmodbus_py.tools.listener.sources import Tap
from libmodbus_py.tools.testing.wires import SerialWire, WireBytes, open_line, write_all
from tests.support.driver import rtu
from tests.support.golden import Refused
from tests.support.peers import until

UNIT = 17

ASK, ANSWER = rtu("01 03 00 00 00 01"), rtu("01 03 02 00 07")


class Line:
    """A port at `path`, and the far end of its line."""

    def __init__(self) -> None:
        self.plug()

    def plug(self) -> None:
        self._far, self._near, self.path = open_line()

    def unplug(self) -> None:
        """Take the port away, as pulling an adapter does."""
        os.close(self._far)
        os.close(self._near)

    def say(self, data: bytes) -> None:
        write_all(self._far, data)


class Mirrored(list[WireBytes]):
    """What has passed a wire, which a line hears, too."""

    def __init__(self, line: Line) -> None:
        super().__init__()
        self._line = line

    def append(self, piece: WireBytes) -> None:
        super().append(piece)
        self._line.say(piece.data)


class Gathering:
    """A thread that listens, until closed."""

    def __init__(self, line: Listener) -> None:
        self.line = line
        self.done: list[Transaction] = []
        self._thread = threading.Thread(target=self._gather)
        self._thread.start()

    def _gather(self) -> None:
        for entry in self.line:
            self.done.append(entry)

    def wait_for(self, count: int) -> list[Transaction]:
        until(lambda: len(self.done) >= count)
        return self.done

    def close(self) -> None:
        self.line.close()
        self._thread.join(10)
        assert not self._thread.is_alive()


@contextmanager
def heard(url: str, **options: str) -> Iterator[Gathering]:
    gathering = Gathering(listen(url, **options))  # type: ignore[arg-type]
    try:
        yield gathering
    finally:
        gathering.close()


@pytest.fixture
def port() -> Iterator[Line]:
    line = Line()
    yield line
    line.unplug()


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_transactions_of_a_client_and_a_server_are_heard(port: Line, framing: str, device: Device):
    with (
        SerialWire() as wire,
        Server({UNIT: device}).background(f"{framing}://{wire.server}?baudrate=115200"),
        heard(f"{framing}://{port.path}?baudrate=115200") as hearing,
        Client(f"{framing}://{wire.client}?baudrate=115200", unit=UNIT) as client,
    ):
        wire.passed = Mirrored(port)
        client.read_holding_registers(100, 3)
        client.write_register(100, 5)
        client.write_register(100, 5)
        client.read_file_records([(4, 7, 3)])
        with pytest.raises(IllegalDataAddress):
            client.read_coils(0, 1)
        client.for_unit(0).write_register(101, 6)
        transactions = hearing.wait_for(6)
    assert [item.kind for item in transactions] == [*(["answered"] * 4), "exception", "broadcast"]
    assert transactions[0].request == pdu.ReadHoldingRegisters(100, 3)
    assert transactions[0].response == [1000, 1001, 1002]
    assert all((transaction.duration or 0) >= 0 for transaction in transactions)
    assert abs(transactions[0].time - time.time()) < 60
    assert hearing.line.summary.units[UNIT].functions[6] == 2
    assert hearing.line.summary.units[UNIT].errors == {"exception 2": 1}


class TestPort:
    def test_a_listener_writes_no_byte_and_locks_no_port(self, port: Line) -> None:
        with listen(f"rtu://{port.path}"):
            descriptors = [
                int(link.name)
                for link in Path("/proc/self/fd").iterdir()
                if link.exists() and os.readlink(link) == port.path
            ]
            modes = {
                int(line.split()[1], 8) & os.O_ACCMODE
                for descriptor in descriptors
                for line in Path(f"/proc/self/fdinfo/{descriptor}").read_text().splitlines()
                if line.startswith("flags:")
            }
            assert os.O_RDONLY in modes
            with Client(f"rtu://{port.path}", unit=1):
                pass  # takes the lock

    def test_an_open_port_is_a_warning(self, port: Line, caplog: pytest.LogCaptureFixture) -> None:
        with (
            Server(Device(Mapping(1, 1, 1, 1))).background(f"rtu://{port.path}"),
            caplog.at_level(logging.WARNING),
            listen(f"rtu://{port.path}?baudrate=9600"),
        ):
            assert "is open in this program, too" in caplog.text

    def test_a_port_is_opened_again_when_it_comes_back(self, port: Line, tmp_path: Path) -> None:
        link = tmp_path / "port"
        link.symlink_to(port.path)
        with heard(f"rtu://{link}") as hearing:
            port.say(ASK)
            time.sleep(0.05)
            port.say(ANSWER)
            hearing.wait_for(1)
            port.say(ASK)
            time.sleep(0.1)
            link.unlink()  # first, as the number of a pseudo-terminal is given again at once
            port.unplug()
            assert hearing.wait_for(2)[1].kind == "unanswered"
            port.plug()
            link.symlink_to(port.path)
            end = time.monotonic() + 20
            while len(hearing.done) < 3 and time.monotonic() < end:
                port.say(ASK)
                time.sleep(0.05)
                port.say(ANSWER)
                time.sleep(0.3)
            assert hearing.wait_for(3)[2].kind == "answered"

    @pytest.mark.parametrize(
        ("path", "what"), [("/dev/nowhere", "No such file"), ("/dev/null", "not a serial port")]
    )
    def test_a_path_that_is_no_serial_port_is_an_error(self, path: str, what: str) -> None:
        with pytest.raises(ModbusConnectionError, match=what):
            listen(f"rtu://{path}")


class TestEnding:
    @pytest.fixture(autouse=True)
    def _sleeps_long(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Else it would wake by itself, soon, and see that it was closed."""
        monkeypatch.setattr(
            importlib.import_module("libmodbus_py.tools.listener.listener"), "IDLE", 99.0
        )

    def test_closing_from_another_thread_ends_the_iteration(self, port: Line) -> None:
        gathering = Gathering(listen(f"rtu://{port.path}"))
        time.sleep(0.1)
        with pytest.raises(RuntimeError, match="listening already"):
            next(gathering.line)
        gathering.close()
        gathering.close()
        assert list(gathering.line) == []

    async def test_close_from_a_signal_handler_and_in_asyncio(self, port: Line) -> None:
        line = listen(f"rtu://{port.path}")
        before = signal.signal(signal.SIGALRM, lambda *_: line.close())
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.2)
            assert list(line) == []
        finally:
            signal.signal(signal.SIGALRM, before)

        line = listen(f"rtu://{port.path}")
        asyncio.get_running_loop().call_later(0.1, line.close)
        assert [entry async for entry in line] == []

    def test_a_cancelled_wait_loses_no_transaction(self, port: Line) -> None:
        async def heard() -> Transaction:
            async with listen(f"rtu://{port.path}") as line:
                for _ in range(5):
                    with pytest.raises(TimeoutError):
                        async with asyncio.timeout(0.02):
                            await anext(line)
                port.say(ASK)
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(0.1):
                        await anext(line)
                port.say(ANSWER)
                return await anext(line)

        assert asyncio.run(heard()).response == [7]

    def test_a_listener_without_a_call_of_close_leaves_nothing(self, port: Line, tmp_path: Path):
        capture = tmp_path / "x.pcapng"
        with listen(f"rtu://{port.path}", capture=capture):
            pass
        with listen(str(capture)) as line:
            assert list(line) == []
        with listen("rtu+tcp://127.0.0.1:0", between="rtu+tcp://127.0.0.1:1"):
            pass
        listen(f"rtu://{port.path}")

    def test_a_forked_child_leaves_the_port_alone(self, port: Line) -> None:
        with listen(f"rtu://{port.path}?parity=N") as line:
            child = os.fork()
            if child == 0:
                line.close()
                os._exit(0)
            assert os.waitpid(child, 0)[1] == 0
            port.say(ASK + ANSWER)
            assert next(line).response == [7]

    def test_rest_returns_unfinished_transactions(self, port: Line) -> None:
        with listen(f"rtu://{port.path}") as line:
            port.say(ASK + ANSWER + ASK)
            assert next(line).kind == "answered"
            assert [entry.kind for entry in line.rest()] == ["unanswered"]


@pytest.fixture(params=["rtu+tcp", "ascii+tcp"])
def tapped(request: pytest.FixtureRequest, device: Device) -> Iterator[Gathering]:
    with ExitStack() as stack:
        server = Server({UNIT: device}).background(f"{request.param}://127.0.0.1:0")
        (target,) = stack.enter_context(server).urls
        yield stack.enter_context(heard(f"{request.param}://127.0.0.1:0", between=target))


class TestBetween:
    def test_a_tap_pairs_the_requests_of_many_clients(self, tapped: Gathering) -> None:
        def ask(address: int) -> None:
            with Client(tapped.line.url, unit=UNIT) as client:
                for _ in range(20):
                    assert client.read_holding_registers(address, 1) == [900 + address]

        with ThreadPoolExecutor(8) as pool:
            list(pool.map(ask, range(100, 108)))
        transactions = tapped.wait_for(160)
        assert {transaction.kind for transaction in transactions} == {"answered"}
        assert len(transactions) == 160

    def test_bytes_pass_unchanged_without_a_listener(self) -> None:
        """More than is kept to be shown."""
        device = socket.create_server(("127.0.0.1", 0))
        data = os.urandom(3_000_000)
        port = device.getsockname()[1]
        with listen("rtu+tcp://127.0.0.1:0", between=f"rtu+tcp://127.0.0.1:{port}") as line:
            client = socket.create_connection(("127.0.0.1", int(line.url.rpartition(":")[2])))
            end, _ = device.accept()
            sending = threading.Thread(target=lambda: (client.sendall(data), client.shutdown(1)))
            sending.start()
            received = b"".join(iter(lambda: end.recv(65536), b""))
            sending.join()
            assert received == data
            assert isinstance(line._source, Tap)
            assert 500_000 < line._source._unseen <= 1 << 20
            end.sendall(b"and back")
            end.close()
            assert b"".join(iter(lambda: client.recv(100), b"")) == b"and back"
            client.close()
            assert next(line).kind == "damaged"
        device.close()

    def test_a_client_is_disconnected_if_the_target_cannot_be_reached(self) -> None:
        nobody = "rtu+tcp://127.0.0.1:1"
        with heard("rtu+tcp://127.0.0.1:0", between=nobody) as hearing:
            place = "127.0.0.1", int(hearing.line.url.rpartition(":")[2])
            with socket.create_connection(place, 10) as client:
                assert client.recv(1) == b""

    def test_a_tap_at_a_port_in_use_is_refused(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            url = f"rtu+tcp://127.0.0.1:{server.getsockname()[1]}"
            with pytest.raises(ModbusConnectionError, match="cannot listen on rtu"):
                listen(url, between="rtu+tcp://127.0.0.1:1")


class TestArguments:
    def test_wrong_arguments_of_listen_are_refused(self, refused: Refused) -> None:
        refused("refused.txt", lambda arguments: listen(arguments[0], between=arguments[1]))

    def test_a_capture_that_cannot_be_written(self, port: Line, tmp_path: Path) -> None:
        with pytest.raises(OSError, match="Is a directory"):
            listen(f"rtu://{port.path}", capture=tmp_path)
        assert stat.S_ISDIR(tmp_path.stat().st_mode)
