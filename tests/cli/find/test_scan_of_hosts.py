"""scan of ranges of hosts, quick scans, what a scan does not know, and spellings of its options."""

import io
import json
from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.find.scan import host_range
from tests.support.cases import each_case
from tests.support.commands import run
from tests.tools.scan.simulated_bus import line


@pytest.fixture
def port() -> Iterator[str]:
    device = Device(Mapping(holding_registers=2))
    with Server({3: device, 30: device}).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0].rpartition(":")[2]


@each_case(
    ("text", "count", "first", "port"),
    [
        ("192.0.2.0/24", 254, "192.0.2.1", 502),
        ("tcp://192.0.2.0/24", 254, "192.0.2.1", 502),
        ("192.0.2.7/30:1502", 2, "192.0.2.5", 1502),
        ("192.0.2.7/32", 1, "192.0.2.7", 502),
        ("[2001:db8::/126]:802", 3, "2001:db8::1", 802),
        ("2001:db8::/126", 3, "2001:db8::1", 502),
        ("10.0.0.0/16", 65534, "10.0.0.1", 502),
    ],
)
def test_a_range_has_its_hosts_and_port(text: str, count: int, first: str, port: int) -> None:
    hosts = host_range(text)
    assert hosts is not None
    assert (len(hosts), hosts[0]) == (count, (first, port))


@each_case("text", ["192.0.2.1", "/dev/ttyUSB0", "tcp://192.0.2.1", "plc/24", "rtu:///dev/x", ""])
def test_other_texts_are_no_range_of_hosts(text: str) -> None:
    assert host_range(text) is None


def test_a_range_is_asked_for_at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = io.StringIO("n\n")
    typed.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr("sys.stdin", typed)
    result = run("scan", "10.0.0.0/16")
    assert result == (1, "", "try 65534 hosts? [y/N] ")


def test_hosts_that_accept_a_connection_are_scanned(port: str) -> None:
    result = run("scan", f"127.0.0.0/29:{port}", "-u", "3,4")
    assert result.code == 0
    assert result.out.startswith(f"tcp://127.0.0.1:{port}: unit 3: ")
    assert result.out.count("\n") == 1
    assert result.err.startswith("6 hosts, 1.0 s at most, and more for each host that accepts")
    report = json.loads(run("scan", f"127.0.0.0/29:{port}", "--json").out)
    assert [unit["unit"] for unit in report["found"]] == [3]  # quick: 30 is not asked
    assert run("read", report["found"][0]["url"], "hr", 0).code == 0


def test_a_range_without_a_server_finds_no_unit() -> None:
    result = run("scan", "127.0.0.0/30:1", "--timeout", "50ms")
    assert result.code == 1
    assert result.err.endswith(
        "tried 0 of 2 hosts, those that accepted a connection: no unit found\n"
    )


def test_a_quick_scan_asks_usual_units(port: str) -> None:
    everything = run("scan", f"127.0.0.1:{port}", "--quick")
    assert everything.err.startswith("14 units, ")
    assert [line.partition(":")[0] for line in everything.out.splitlines()] == ["unit 3"]
    assert run("scan", f"127.0.0.1:{port}", "--quick", "-u", "30").out.startswith("unit 30: ")


@each_case(
    ("words", "setting"),
    [
        (["-p", "none"], "9600 8N1 or 8N2"),
        (["-p", "none", "-s", "1"], "9600 8N1:"),
        (["-p", "even"], "9600 8E1:"),
    ],
)
def test_a_scan_prints_no_stop_bits_that_it_did_not_measure(words: list[str], setting: str) -> None:
    with line({1: Device(Mapping(holding_registers=2))}) as wire:
        result = run("scan", wire.client, "-b", "9600", "-u", "1", *words)
    assert f"unit 1 at {setting}" in result.out


@each_case(
    ("words", "summary"),
    [
        (["-b", "9600", "-p", "none", "-u", "1"], "1 unit, "),
        (["-b", "9600,19200", "-p", "none,Even,O", "-u", "1-2"], "2 units at 6 settings, "),
        (["--baudrate", "9600", "--parity", "n,N,none", "--unit", "1"], "1 unit, "),
        (["--baudrates", "9600", "--parities", "E,N", "--units", "1"], "1 unit at 2 settings, "),
        (["--quick"], "13 units at 4 settings, "),
        (["--quick", "-b", "4800"], "13 units at 2 settings, "),
    ],
)
def test_a_scan_of_a_line_accepts_its_options(words: list[str], summary: str) -> None:
    assert run("scan", "/dev/no-such", *words).err.startswith(summary)
