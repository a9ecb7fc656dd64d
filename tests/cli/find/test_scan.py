"""The command scan: what it prints, where, and its exit codes."""

import json
import os
import signal
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server, device_file
from tests.support.commands import Started, on_terminal, run
from tests.support.peers import FakeServer, mbap, refusing, until, url_of
from tests.tools.scan.simulated_bus import Member, SimulatedBus, line, of, simulated


@pytest.fixture
def url() -> Iterator[str]:
    devices = {
        3: Device(
            Mapping(holding_registers=[range(4), range(6, 8)], coils=1),
            identification={"VendorName": "ACME", "ProductCode": "\x1b[31m", 2: "1"},
        ),
        7: Device(Mapping()),
    }
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_units_that_answer_are_printed_and_messages_go_to_stderr(url: str) -> None:
    result = run("scan", url)
    assert result.code == 0
    first, second = result.out.splitlines()
    assert first.startswith("unit 3: ")
    assert "ACME" in first
    assert second.startswith("unit 7: ")
    assert ", exception 2" in second
    assert "\x1b" not in result.out + result.err  # whatever a device says
    estimate, note, summary = result.err.splitlines()
    assert estimate.startswith("248 units, ")
    assert summary == f"tried units 1-247,255 at {url}: 2 units found"
    assert "4 min 9 s at most" in estimate
    assert "a gateway reports 246 units" in note


def test_a_scan_prints_json_in_one_line(url: str) -> None:
    result = run("scan", url, "--units", "1,3-4", "--json", "--deep")
    assert result.out.count("\n") == 1
    report = json.loads(result.out)
    assert report["stopped"] is False
    assert len(report["notes"]) == 1
    (device,) = report["found"]
    assert (device["unit"], device["exception"], device["baudrate"]) == (3, None, None)
    assert device["identification"]["VendorName"] == "ACME"
    assert device["tables"]["holding_registers"]["ranges"] == [
        {"address": 0, "count": 4},
        {"address": 6, "count": 2},
    ]
    assert sum(row["requests"] for row in device["tables"].values()) <= 2000


def test_the_output_of_deep_is_a_device_file(url: str, tmp_path: Path) -> None:
    result = run("scan", url, "--units", "3,7", "--deep")
    assert result.code == 0
    assert "up to 2000 requests to each unit found" in result.err
    assert [unit["id"] for unit in tomllib.loads(result.out)["unit"]] == [3, 7]
    assert "# coils: ended by the bound on requests, ranges of up to" in result.out
    path = tmp_path / "found.toml"
    path.write_text(result.out)
    devices = device_file.load(path).devices
    assert isinstance(devices, dict)
    assert devices[3].mapping.holding_registers[6:8] == [0, 0]


def test_a_copy_of_a_device_has_its_values(tmp_path: Path) -> None:
    there = Mapping(
        coils={1: [1, 0, 1]},
        discrete_inputs={100: [1]},
        holding_registers={0: [7, 0, 65535], 200: [555]},
        input_registers={100: [*range(1, 201)]},
    )
    with Server({3: Device(there)}).background("tcp://127.0.0.1:0") as running:
        result = run("scan", running.urls[0], "-u", 3, "--deep", "--values")
        data = json.loads(run("scan", running.urls[0], "-u", 3, "--deep", "--values", "--json").out)
    (tmp_path / "copy.toml").write_text(result.out)
    devices = device_file.load(tmp_path / "copy.toml").devices
    assert isinstance(devices, dict)
    copy = devices[3].mapping
    assert copy.coils[1:4] == [1, 0, 1]
    assert copy.discrete_inputs[100:101] == [1]
    assert copy.holding_registers[0:3] == [7, 0, 65535]
    assert copy.holding_registers[200:201] == [555]
    assert copy.input_registers[100:300] == [*range(1, 201)]
    assert data["found"][0]["tables"]["coils"]["ranges"] == [
        {"address": 1, "count": 3, "values": [1, 0, 1]}
    ]


def test_values_without_deep_are_refused() -> None:
    result = run("scan", "tcp://127.0.0.1:1", "--values")
    assert (result.code, result.out) == (2, "")
    assert "--values needs --deep" in result.err


def test_the_last_line_says_what_was_tried_on_a_line() -> None:
    with simulated() as network:
        SimulatedBus(network, {})
        result = run("scan", "/dev/line", "--timeout", "20ms")
        short = run("scan", "/dev/line", "-b", "9600,300", "-p", "even,none", "-u", "1-3,9")
    assert (result.code, result.out) == (1, "")
    estimate, summary = result.err.splitlines()
    assert estimate.startswith("247 units at 24 settings, ")
    assert summary.startswith("tried units 1-247 at 9600 8E1, 9600 8N1 or 8N2, 19200 8E1, ")
    assert summary.endswith(": no unit found")
    assert summary.count(" 8E1") == summary.count(" 8N1 or 8N2") == summary.count(" 8O1") == 8
    assert short.err.splitlines()[-1] == (
        "tried units 1-3,9 at 9600 8E1, 9600 8N1 or 8N2, 300 8E1, 300 8N1 or 8N2: no unit found"
    )


def test_a_stopped_scan_reports_only_what_was_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    with simulated() as network:
        bus = SimulatedBus(network, {2: Member(of(Device(Mapping())), 19200)})
        hear = bus.hear

        def stop(data: bytes) -> None:
            if len(bus.asked) >= 20:
                raise KeyboardInterrupt
            hear(data)

        monkeypatch.setattr(bus, "hear", stop)
        result = run("scan", "/dev/line")
    assert result.code == 130
    assert result.err.splitlines()[-1] == (
        "tried units 1-3,247 at 9600 8E1, 9600 8N1 or 8N2, 19200 8E1, 19200 8N1 or 8N2;"
        " unit 1 at 9600 8O1: 1 unit found so far"
    )


def test_a_port_that_refuses_every_setting_is_reported_and_json_is_printed() -> None:
    with refusing() as bound:
        result = run("scan", url_of(bound), "--json")
    assert result.code == 1
    assert result.err.splitlines()[-1].startswith("libmodbus-py: ")
    assert json.loads(result.out) == {"found": [], "tried": {}, "notes": [], "stopped": True}


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, -signal.SIGTERM)]
)
@pytest.mark.parametrize("as_json", [False, True])
def test_a_signal_prints_what_was_found_and_restores_the_line(as_json, number, code) -> None:
    with line({1: Device(Mapping())}) as wire:
        arguments = ["--baudrates", "19200", *["--json"] * as_json]
        with Started("scan", f"rtu://{wire.client}", *arguments) as process:
            # The unit behind those that answered, reserved ones and identification included.
            until(lambda: wire.sent_by("client").count(b"\x02\x03\0\0\0\1") == 1)
            process.send_signal(number)
            output, errors = process.communicate()
        assert process.returncode == code
        assert "Traceback" not in errors
        if as_json:
            report = json.loads(output)
            assert report["stopped"] is True
            assert [unit["unit"] for unit in report["found"]] == [1]
        else:
            assert output.startswith("unit 1 at 19200 8E1: ")


def test_ctrl_c_in_a_search_prints_what_was_found() -> None:
    def answer(request: bytes) -> list[bytes]:
        count = int.from_bytes(request[10:12], "big")
        if request[6] != 1 or request[7] > 4:
            return [mbap(request, bytes([request[7] | 0x80, 11]))]
        size = (count + 7) // 8 if request[7] < 3 else 2 * count
        time.sleep(0.01)
        return [mbap(request, bytes([request[7], size]) + bytes(size))]

    with (
        FakeServer(answer) as server,
        Started("scan", server.url, "--units", "1", "--deep") as process,
    ):
        until(lambda: len(server.requests) > 60)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "[[unit.coils]]\naddress = 0\ncount = 65536\n" in output
    assert "# discrete_inputs: ended by the user" in output


def test_a_scan_shows_its_progress_on_a_terminal() -> None:
    def answer(request: bytes) -> list[bytes]:
        time.sleep(0.05)
        return [mbap(request, b"\x83\x0b")]

    read, write = os.pipe()
    with (
        FakeServer(answer) as server,
        open(read, "rb") as printed,
        on_terminal("scan", server.url, "--units", "1-20", stdout=write) as terminal,
    ):
        os.close(write)
        text = terminal.read_to_end()
        output = printed.read()
    assert "of 20 asked, 0 found" in text
    assert "left at most\x1b[K" in text
    assert "\r\x1b[K" in text  # the line is removed before other output
    assert output == b""
