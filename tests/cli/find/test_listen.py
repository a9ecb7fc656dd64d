"""The command listen: lines, JSON, colours, captures, and how it ends."""

import json
import re
import resource
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, IllegalDataAddress, Mapping, ModbusTimeoutError, Server
from libmodbus_py.tools.listener.listener import Listener
from libmodbus_py.tools.listener.transaction import Transaction
from tests.support.commands import Result, Started, on_terminal, run
from tests.support.golden import Golden
from tests.support.peers import until

DECODED = Path(__file__).parents[2] / "tools" / "listener" / "decoded.pcapng"


def listen(*arguments: object) -> Result:
    return run("listen", *arguments)


def listening(*arguments: object) -> Started:
    return Started("listen", *arguments)


def url_of(process: Started) -> str:
    line = process.stderr.readline()
    assert line.startswith("listening on "), line
    return line.removeprefix("listening on ").rstrip("\n")


@pytest.fixture
def target() -> Iterator[str]:
    mapping = Mapping(holding_registers={0: [7, 8, 9]})
    with Server({1: Device(mapping)}).background("rtu+tcp://127.0.0.1:0") as running:
        yield running.urls[0]


# WriteRegister(address=0, value=1) to unit 2.
NOT_ANSWERED = bytes.fromhex("02 06 0000 0001")


def ask(url: str) -> None:
    with Client(url, unit=1, timeout=20) as client:
        client.read_holding_registers(0, 3)
        with pytest.raises(IllegalDataAddress):
            client.read_holding_registers(3, 1)
        client.write_register(0, 1)
        with pytest.raises(ModbusTimeoutError):
            client.for_unit(2, timeout=0.02).write_register(0, 1)


def lines_of(process: Started, count: int) -> list[str]:
    return [process.stdout.readline().rstrip("\n") for _ in range(count)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_transactions_a_summary_and_a_capture_are_written(target: str, number: int, tmp_path: Path):
    file = tmp_path / "x.pcapng"
    with listening("rtu+tcp://127.0.0.1:0", "--between", target, "--capture", file) as process:
        ask(url_of(process))
        read, refused, write = lines_of(process, 3)
        # What had no answer prints no line; it is heard when it is in the file.
        until(lambda: NOT_ANSWERED in file.read_bytes())
        process.send_signal(number)
        rest, errors = process.communicate()
    assert process.returncode == 0
    assert errors == ""
    assert re.fullmatch(
        r"\d\d:\d\d:\d\d\.\d{3}   1 +\d+\.\d ms  "
        r"ReadHoldingRegisters\(address=0, count=3\) -> \[7, 8, 9\]",
        read,
    )
    assert refused.endswith("-> illegal data address (exception 2)")
    assert write.endswith("WriteRegister(address=0, value=1) -> done")
    loss, counts, *_ = rest.splitlines()  # what was open at the end is told, too
    assert loss.endswith("WriteRegister(address=0, value=1) -> no answer")
    assert counts == "4 transactions, 0 runs of damaged bytes"
    assert "\nunit 1: 3 transactions" in rest
    assert "  functions     3 (2), 6 (1)" in rest
    assert "  errors        1 exception 2" in rest
    assert "unit 2: 1 transactions" in rest
    assert "\x1b" not in read + refused + write + rest
    *rows, end = map(json.loads, listen(file, "--json").out.splitlines())
    assert [row["kind"] for row in rows] == ["answered", "exception", "answered", "unanswered"]
    assert (rows[0]["response"], rows[3]["response"]) == ([7, 8, 9], None)
    assert end["summary"]["units"]["1"]["functions"] == {"3": 2, "6": 1}


def test_a_signal_right_after_the_first_line_ends_listen_in_order(target: str, monkeypatch) -> None:
    def print_and_interrupt(text: object, **options: Any) -> None:
        print(text, **options)
        if str(text).startswith("listening on "):
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("libmodbus_py.cli.find.listen.print", print_and_interrupt, raising=False)
    result = listen("rtu+tcp://127.0.0.1:0", "--between", target)
    assert result.code == 0
    assert result.out == "0 transactions, 0 runs of damaged bytes\n"


@pytest.mark.parametrize("handler", [signal.default_int_handler, signal.SIG_IGN])
def test_a_signal_while_printing_loses_no_line(monkeypatch, handler) -> None:
    whole, next_transaction = listen(DECODED), Listener.__next__

    def hear_and_interrupt(line: Listener) -> Transaction:
        transaction = next_transaction(line)
        signal.raise_signal(signal.SIGINT)
        return transaction

    monkeypatch.setattr(Listener, "__next__", hear_and_interrupt)
    before = signal.signal(signal.SIGINT, handler)
    try:
        result = listen(DECODED)
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)
    if handler is signal.SIG_IGN:  # as in the background of a script
        assert result == whole
    else:
        assert result.out.splitlines()[1].startswith("1 transactions, ")


def test_a_second_signal_ends_the_output(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("it goes on")

    monkeypatch.setattr("libmodbus_py.cli.find.listen.print", interrupt, raising=False)
    assert listen(DECODED).code == 130


def test_a_capture_is_read_again(golden: Golden, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setenv("TZ", "UTC")
        time.tzset()
        result = listen(DECODED)
    time.tzset()
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert sum("damaged: " in line for line in lines) == 3
    assert "47 transactions, 3 runs of damaged bytes" in lines
    golden("decoded.txt", result.out)
    result = listen(DECODED, "--json")
    assert (result.code, result.err) == (0, "")
    assert len([json.loads(line) for line in result.out.splitlines()]) == 47 + 3 + 1
    golden("decoded.jsonl", result.out)


def test_listen_prints_the_units_that_were_typed() -> None:
    everything = [json.loads(line) for line in run("listen", DECODED, "--json").out.splitlines()]
    units = {row.get("unit") for row in everything[:-1]}
    unit = min(unit for unit in units if unit is not None)
    assert len(units) > 1
    some = [
        json.loads(line) for line in run("listen", DECODED, "-u", unit, "--json").out.splitlines()
    ]
    assert some[:-1] == [row for row in everything[:-1] if row["unit"] == unit]


@pytest.mark.parametrize("size", range(330, 420, 15))
def test_a_capture_on_a_full_disk_can_be_read(size: int, target: str, tmp_path: Path) -> None:
    """Whichever byte is the last that the disk takes. The command says that all is not there."""
    path = tmp_path / "x.pcapng"
    with listening("rtu+tcp://127.0.0.1:0", "--between", target, "--capture", path) as process:
        url = url_of(process)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, size))
        with Client(url, unit=1) as client:
            for _ in range(4):
                assert client.read_holding_registers(0, 1) == [7]
                assert "-> [7]" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    assert process.returncode == 1
    assert errors == f"{path}: File too large; the capture ends here\n"
    assert path.stat().st_size <= size
    *transactions, _ = map(json.loads, listen(path, "--json").out.splitlines())
    assert 0 < len(transactions) < 4
    assert transactions[0]["kind"] == "answered"


@pytest.mark.parametrize(("variables", "coloured"), [({}, True), ({"NO_COLOR": "1"}, False)])
def test_variables_forbid_colours(variables: dict[str, str], coloured: bool) -> None:
    with on_terminal("listen", DECODED, environment=variables) as terminal:
        text = terminal.read_to_end()
        assert terminal.process.wait() == 0
    assert ("\x1b[31mdamaged" in text) == coloured
    assert ("\x1b[33millegal" in text) == coloured


def test_texts_of_devices_cannot_move_the_cursor_of_the_terminal(target: str) -> None:
    """Escape sequences in names of devices are shown, not sent."""
    device = Device(Mapping(1, 1, 1, 1), identification={0: b"\x1b[2J\x07", 1: b"\n", 2: b"\r"})
    with (
        Server({1: device}).background("rtu+tcp://127.0.0.1:0") as running,
        listening("rtu+tcp://127.0.0.1:0", "--between", running.urls[0]) as process,
    ):
        with Client(url_of(process), unit=1) as client:
            client.read_device_identification()
        (line,) = lines_of(process, 1)
    assert "\x1b" not in line
    assert r"\x1b[2J\x07" in line


MAP = """\
name,table,address,type,scale,units,missing
level,holding,0,uint16,0.1,m,
limit,holding,1,uint16,,,8
speed,holding,2,uint16,,rpm,
"""


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    path.write_text(MAP)
    return path


def test_values_have_the_names_that_read_prints(target: str, points: Path, tmp_path: Path) -> None:
    file = tmp_path / "x.pcapng"
    with listening(
        "rtu+tcp://127.0.0.1:0", "--between", target, "--map", points, "--capture", file
    ) as process:
        url = url_of(process)
        read = run("read", url, "-u", 1, "--map", points).out.splitlines()
        lines = lines_of(process, 3)
        assert run("write", url, "-u", 1, "--map", points, "speed", 5).code == 0
        (write,) = lines_of(process, 1)
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate()
    assert [" ".join(line.split()[1:]) for line in lines] == [
        f"1 {' '.join(x.split())}" for x in read
    ]
    assert lines[1].endswith("1  limit  - (Missing)")
    assert write.endswith("1  speed  5 rpm  (written)")
    assert rest.startswith("2 transactions, ")
    csv = [line.split(",") for line in listen(file, "--map", points, "--csv").out.splitlines()]
    assert [row[1:] for row in csv] == [
        ["unit", "name", "value", "units", "written", "error"],
        ["1", "level", "0.7", "m", "0", ""],
        ["1", "limit", "", "", "0", "Missing"],
        ["1", "speed", "9", "rpm", "0", ""],
        ["1", "speed", "5", "rpm", "1", ""],
    ]
    *transactions, _ = map(json.loads, listen(file, "--map", points, "--json").out.splitlines())
    assert [transaction["value"] for transaction in transactions] == [0.7, None, 9, 5]
    assert [transaction["written"] for transaction in transactions] == [False, False, False, True]
    values = json.loads(run("read", target, "-u", 1, "--map", points, "--json").out)
    assert transactions[1]["no_value"] == values["no_value"]["limit"]
    assert listen(file, "--map", points, "--csv", "-u", 2).out.count("\n") == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_reads_of_a_master_become_a_map(target: str, number: int, tmp_path: Path) -> None:
    path = tmp_path / "asked.csv"
    with listening("rtu+tcp://127.0.0.1:0", "--between", target, "--learn", path) as process:
        with Client(url_of(process), unit=1) as client:
            client.read_holding_registers(1, 2)
            client.write_register(0, 3)
        lines_of(process, 2)
        assert not path.exists()
        process.send_signal(number)
        _, errors = process.communicate()
    assert errors == f"{path}: 3 points; fill in names, types and units\n"
    assert path.read_text().splitlines()[1:] == [
        "name,table,address,type,access,description,group",
        "unit_1_holding_registers_0,holding_registers,0,uint16,write,3,unit 1",
        "unit_1_holding_registers_1,holding_registers,1,uint16,read,8,unit 1",
        "unit_1_holding_registers_2,holding_registers,2,uint16,read,9,unit 1",
    ]
    read = run("read", target, "-u", 1, "--map", path, "--group", "unit 1", "--json").out
    assert [*json.loads(read)["values"].values()] == [8, 9]


def test_invalid_options_about_names_are_refused(tmp_path: Path) -> None:
    existing = tmp_path / "asked.csv"
    existing.write_text("mine")
    for arguments, message in (
        (["--learn", existing], f"{existing} exists, and would be overwritten"),
        (["--learn", tmp_path / "x.txt"], "it must end with .toml or .csv"),
        (["--csv"], "--csv needs --map"),
        (["--column", "name=x"], "--column, --from and --list need --map"),
    ):
        result = listen(DECODED, *arguments)
        assert (result.code, result.out) == (2, "")
        assert message in result.err
    assert existing.read_text() == "mine"
