"""The command poll: what it prints, writes and exposes, and how it ends."""

import asyncio
import json
import re
import signal
import socket
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.serve import fleet as workers
from libmodbus_py.services.engine.connection import EngineGone
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.cli.serving import FLEET_OF_ONE
from tests.support.cases import each_case
from tests.support.commands import Started, on_terminal, run, run_forked
from tests.support.peers import mute_port

LONGEST = 30

METER = """name,table,address,scale,unit
voltage,holding_registers,0,0.1,V
current,holding_registers,1,0.01,A
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Path]:
    """Two devices that answer and one that does not, each 0.1 s."""
    device = Device(Mapping(holding_registers={0: [2305, 150]}))
    with Server({1: device, 2: device}).background("tcp://127.0.0.1:0") as running:
        (tmp_path / "meter.csv").write_text(METER)
        (tmp_path / "fleet.toml").write_text(
            f"""
            [defaults]
            map = "meter.csv"
            interval = 0.1
            [[device]]
            name = "one"
            url = "{running.urls[0]}"
            labels = {{ site = "here" }}
            [[device]]
            name = "two"
            url = "{running.urls[0]}"
            unit = 2
            [[device]]
            name = "gone"
            url = "tcp://127.0.0.1:1"
            """
        )
        yield tmp_path / "fleet.toml"


def start(*arguments: object) -> Started:
    return Started("poll", *arguments)


def test_a_single_poll_goes_to_several_outputs(fleet: Path) -> None:
    a, b, c = (fleet.with_name(name) for name in ("a.csv", "b.csv", "c.jsonl"))
    options = ["--csv", a, "--json", c, "--csv", b, "--json"]  # which may be repeated
    result = run_forked("poll", fleet, "--once", *options)
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert sorted(c.read_text().splitlines()) == sorted(result.out.splitlines())
    assert sorted(a.read_text().splitlines()) == sorted(b.read_text().splitlines())
    assert len(a.read_text().splitlines()) == 7
    assert sorted((row["device"], row["name"], row["value"]) for row in rows) == [
        ("gone", "current", None),
        ("gone", "voltage", None),
        ("one", "current", 1.5),
        ("one", "voltage", 230.5),
        ("two", "current", 1.5),
        ("two", "voltage", 230.5),
    ]
    assert result.code == 1  # one gave no answer
    assert result.err == ""


def test_check_prints_a_table_and_the_overloaded_lines(fleet: Path) -> None:
    text = fleet.read_text() + (
        '[[device]]\nname = "slow"\nurl = "rtu:///dev/nowhere?baudrate=1200"\ninterval = 0.05\n'
    )
    fleet.write_text(text)
    result = run("poll", fleet, "--check")
    head, *rows = result.out.splitlines()
    assert head.split() == ["device", "url", "unit", "requests", "took", "interval", "result"]
    rows_of = {row.split()[0]: row for row in rows}
    assert rows_of.keys() == {"one", "two", "gone", "slow"}
    assert rows_of["one"].endswith(" ok")
    assert "Connection refused" in rows_of["gone"]
    # 8 bytes of request, 9 of answer, twice 3.5 characters of silence; 11 bits each.
    assert result.err.splitlines() == [
        "libmodbus-py: line rtu:///dev/nowhere at 1200: 0.22 s of requests each 0.05 s",
        "libmodbus-py: 2 of 4 devices failed, or had bad points",
    ]
    assert result.code == 1


def test_all_mistakes_in_devices_are_printed(fleet: Path) -> None:
    fleet.write_text(fleet.read_text() + "unit = 300\n" + '[[device]]\nname = "a"\nurl = "x:"\n')
    result = run("poll", fleet)
    first, second = result.err.splitlines()
    assert (result.code, result.out) == (2, "")
    assert "device[2].unit " in first
    assert "device[3].url: " in second


def test_the_summary_says_how_a_list_of_devices_was_read(fleet: Path) -> None:
    rows = "Geräte;\nname;url\ndrei;tcp://127.0.0.1:1\n"
    (fleet.parent / "list.csv").write_bytes(rows.encode("cp1252"))
    fleet.write_text('devices = "list.csv"\nencoding = "cp1252"\n' + fleet.read_text())
    lines = run("poll", fleet, "--check").err.splitlines()
    assert "list.csv: read as cp1252" in lines[0]
    assert lines[1].endswith("list.csv: rows above the headings that are skipped: 1")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_poll_with_a_summary(fleet: Path, number: signal.Signals) -> None:
    with start(fleet) as polling:
        first = json.loads(polling.stdout.readline())
        assert first["device"] in ("one", "two", "gone")
        polling.send_signal(number)
        _, error = polling.communicate()
    assert polling.returncode == 0
    summary, output = error.splitlines()
    assert " polls in " in summary
    assert "within 100 ms of their time" in summary
    assert output.startswith("json: ")
    assert output.endswith(" written, 0 dropped")


def test_a_signal_while_all_outputs_wait_ends_the_poll(tmp_path: Path) -> None:
    """For answers and for a connection, a minute each."""
    (tmp_path / "meter.csv").write_text(METER)
    path = tmp_path / "fleet.toml"
    with mute_port() as port, socket.create_server(("127.0.0.1", 0)) as silent:
        path.write_text(
            "[defaults]\nmap = 'meter.csv'\ninterval = 0.1\n"
            f"[[device]]\nname = 'a'\nurl = 'tcp://127.0.0.1:{port}?timeout=60'\n"
            f"[[device]]\nname = 'b'\nurl = 'tcp://127.0.0.1:{silent.getsockname()[1]}?timeout=60'\n"
        )
        with start(path) as polling:
            silent.settimeout(LONGEST)
            peer, _ = silent.accept()
            with peer:
                assert peer.recv(100)
                time.sleep(0.2)
                polling.send_signal(signal.SIGINT)
                polling.communicate()
    assert polling.returncode == 0


class NoPolling:
    """A worker that has nothing to do."""

    def __init__(self, *_: object, **__: object) -> None:
        self.fleet = None

    def engine_changed(self) -> None: ...

    def leave(self) -> None: ...

    async def run(self) -> None:
        assert signal.getsignal(signal.SIGTERM).__name__ != "own_handler"


async def nothing(*_: object, **__: object) -> tuple[None, None]:
    return None, None


@pytest.mark.parametrize("mode", [["--once"], ["--engine", "nats://127.0.0.1:1"]])
def test_the_poll_restores_the_signal_handlers_of_a_program(fleet: Path, monkeypatch, mode) -> None:
    for name in ("engine.open_connection", "engine.disconnect", "_opened"):
        monkeypatch.setattr(f"{workers.__name__}.{name}", nothing)
    monkeypatch.setattr(workers, "Polling", NoPolling)
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def own_handler(number: int, frame: object) -> None:
        raise AssertionError(f"nobody sends signal {number}")

    before = {number: signal.signal(number, own_handler) for number in numbers}
    result = run("poll", fleet, *mode, "--json", fleet.with_name("readings.json"))
    assert result.code == (mode == ["--once"])  # one device does not answer
    handlers = [signal.signal(number, handler) for number, handler in before.items()]
    assert handlers == [own_handler] * 3
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == set()


def test_each_reason_to_wait_for_the_engine_is_logged_once(monkeypatch, caplog) -> None:
    reasons = ["no answer", "no leader", "no answer", "no leader"]

    async def ask() -> str:
        if reasons:
            raise EngineGone(reasons.pop(0))
        return "there"

    monkeypatch.setattr(workers, "PAUSE", 0)
    assert asyncio.run(workers._answered(ask)) == "there"
    assert caplog.messages == [f"waiting for the engine: no {why}" for why in ("answer", "leader")]


@pytest.mark.parametrize("form", ["--json", "--csv"])
def test_a_full_disk_is_reported_in_one_line(fleet: Path, form: str) -> None:
    with open("/dev/full", "w") as full:
        result = run_forked("poll", fleet, form, stdout=full.fileno())
    assert result.code == 1
    assert result.err == "libmodbus-py: standard output: No space left on device\n"


def test_polls_go_to_files_and_metrics(fleet: Path) -> None:
    pytest.importorskip("prometheus_client")
    rows = fleet.parent / "readings.csv"
    samples = (
        "modbus_fleet_up 2.0",
        'modbus_fleet_device_up{device="one",site="here"} 1.0',
        'modbus_fleet_device_up{device="gone"} 0.0',
        'modbus_fleet_device_down{device="gone",reason="ModbusConnectionError"} 1.0',
        'modbus_fleet_value{device="one",name="voltage",site="here",unit="V"} 230.5',
        'modbus_fleet_value{device="two",name="voltage",unit="V"} 230.5',
    )
    with start(fleet, "--csv", rows, "--metrics", "127.0.0.1:0") as polling:
        message = polling.stderr.readline()
        assert message.startswith("metrics on http://127.0.0.1:")
        url = message.split()[-1]
        end = time.monotonic() + LONGEST
        metrics = ""
        while not all(sample in metrics for sample in samples):
            assert time.monotonic() < end
            time.sleep(0.05)
            with urllib.request.urlopen(url, timeout=LONGEST) as page:
                metrics = page.read().decode()
        polling.terminate()
        out, _ = polling.communicate()
    assert out == ""
    assert "modbus_fleet_devices 3.0" in metrics
    assert "modbus_fleet_polls_total" in metrics
    assert f'modbus_fleet_output_is_failing{{output="csv {rows}"}} 0.0' in metrics
    assert 'output="metrics"' not in metrics
    assert 'modbus_fleet_lateness_seconds_bucket{le="+Inf"}' in metrics
    assert len(rows.read_text().splitlines()) > 4


@pytest.mark.parametrize(("term", "options"), [("xterm", []), ("dumb", []), ("xterm", ["-v"])])
def test_a_status_line_on_a_terminal(fleet: Path, term: str, options: list[str]) -> None:
    command = ("poll", fleet, "--csv", "/nowhere/at/all", *options)
    with on_terminal(*command, columns=200, environment={"TERM": term}) as terminal:
        terminal.until(lambda text: "2 of 3 devices up; 1 of 3 devices down (gone)" in text)
        terminal.until(lambda text: "; output csv /nowhere/at/all fails; " in text)
        terminal.process.send_signal(signal.SIGINT)
        output = terminal.read_to_end()
    assert " polls a second, at most " in output
    assert '"device"' not in output  # values are for files and pipes


def with_journal(fleet: Path) -> Path:
    file = fleet.with_name("kept.toml")
    file.write_text(f'journal = "fleet.db"\n{fleet.read_text()}[output.csv]\npath = "kept.csv"\n')
    return file


def test_a_journal_is_reported_at_the_end_and_used_by_one_program(fleet: Path) -> None:
    file = with_journal(fleet)
    with start(file, "--json") as process:
        ids = [json.loads(process.stdout.readline())["id"] for _ in range(10)]
        assert ids == list(range(ids[0], ids[0] + 10))
        code, _, err = run("poll", file)
        assert code == 1
        assert err == f"libmodbus-py: {fleet.with_name('fleet.db')}: is used by another program\n"
        process.terminate()
        _, err = process.communicate()
    assert process.returncode == 0, err
    summary = r"^journal: \d+ written, 0 dropped, 0\.\d MB$"
    assert re.search(summary, err, re.MULTILINE), err
    # The standard output has the readings of this run only.
    code, out, _ = run_forked("poll", file, "--once", "--json")
    assert code == 1  # one device does not answer
    assert out.count('"voltage"') == 3


@each_case(
    ("journal", "path", "message"),
    [
        ("", "readings.jsonl", ""),
        ("", "/nowhere/at/all", "/all: 0 written, 1 dropped: /nowhere/at/all: No such file"),
        ("journal = 'kept.db'\n", "/nowhere/at/all", "0 dropped, 1 wait in the journal: /nowhere"),
    ],
)
def test_an_output_that_accepts_nothing_is_named(tmp_path_factory, journal, path, message) -> None:
    folder = tmp_path_factory.mktemp("once")
    with ServerMaker() as maker:
        (folder / "fleet.toml").write_text(journal + FLEET_OF_ONE.format(url=maker().url))
        result = run_forked(
            "poll", folder / "fleet.toml", "--once", f"--json={folder / path}", "--csv"
        )
    assert result.code == bool(message)
    assert message in result.err
    assert bool(result.err) == bool(message)
    assert result.out.count("\n") == 2  # the other output got all readings
