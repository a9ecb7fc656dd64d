"""Captures on the command line: serve --replay answers as it did, listen --compare-with asks."""

from pathlib import Path

import pytest

from libmodbus_py import Client
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import run
from tests.tools.listener.test_network_captures import TWO, packet, pcap

WRITE = bytes.fromhex("0004 0000 0006 01 06 0001 0003")


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "plant.pcap"
    writing = [packet(WRITE, 124, asks=True), packet(WRITE, 927, asks=False)]
    path.write_bytes(pcap([*TWO, *writing]))
    return path


def test_a_capture_has_no_differences_from_its_replay(capture: Path) -> None:
    with serving("serve", "tcp://127.0.0.1:0", "--replay", capture) as (_, url):
        with Client(url) as client:
            assert client.read_holding_registers(107, 3) == [555, 0, 100]
        result = run("listen", capture, "--compare-with", url, "--writes")
        assert (result.code, result.out) == (0, "")
        assert result.err.endswith("3 requests, 0 with another answer now\n")
    with serving("serve", "tcp://127.0.0.1:0") as (_, url):
        result = run("listen", capture, "--compare-with", url, "-u", 9)
        assert (result.code, result.out) == (2, "")
        assert "plant.pcap: no request to send; --writes sends" in result.err
        result = run("listen", capture, "--compare-with", url)
        assert (result.code, result.out.count("; now [")) == (1, 2)
        assert "count=3) -> [555, 0, 100]; now [0, 0, 0]\n" in result.out
        assert result.err.endswith("2 requests, 2 with another answer now\n")


@each_case(
    ("words", "message"),
    [
        (
            ["serve", "127.0.0.1:0", "--replay", "{}", "-u", "1"],
            "--units cannot be given with --rep",
        ),
        (["serve", "127.0.0.1:0", "--replay", "{}", "--state", "x"], "--state cannot be given"),
        (["serve", "127.0.0.1:0", "--replay", "{}", "--map", "sdm120"], "not allowed with"),
        (
            ["serve", "127.0.0.1:0", "--replay", "/dev/null"],
            "/dev/null: the name of a capture must end with .pcap",
        ),
        (["listen", "{}", "--compare-with", "127.0.0.1", "--csv"], "--csv cannot be given with"),
        (
            ["listen", "/dev/null", "--compare-with", "127.0.0.1"],
            "URL must be a capture with --com",
        ),
        (["listen", "{}", "--writes"], "--writes needs --compare-with"),
    ],
)
def test_options_that_exclude_each_other(words: list[str], message: str, capture: Path) -> None:
    result = run(*(word.format(capture) for word in words))
    assert (result.code, result.out) == (2, "")
    assert message in result.err
