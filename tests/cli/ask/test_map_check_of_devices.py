"""
map check --device: the points of a map that a device lacks.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import Device, Fault, Mapping
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.commands import run


@pytest.fixture
def points(tmp_path: Path) -> Path:
    lines = [f"p{at},holding_registers,{at},uint16" for at in range(20)]
    (tmp_path / "points.csv").write_text("\n".join(["name,table,address,type", *lines]))
    return tmp_path / "points.csv"


def device(*missing: int) -> Device:
    return Device(Mapping(holding_registers={at: [at] for at in range(20) if at not in missing}))


def test_points_that_a_device_lacks_are_told(points: Path) -> None:
    with ServerMaker() as maker:
        server = maker(devices=device(3, 11, 12))
        done = run("map", "check", points, "--device", server.url)
    assert done.out.splitlines()[-1] == (
        f"  {server.url}, unit 1: 17 of 20 points can be read, in 3 requests"
    )
    told = done.err.splitlines()
    assert [line.split(":")[1].split()[0] for line in told] == ["p3", "p11", "p12"]
    assert all("illegal data address (exception 2)" in line for line in told)
    assert done.code == 1
    assert len(server.transactions) <= 30


def test_a_device_that_has_all_points(points: Path) -> None:
    with ServerMaker() as maker:
        server = maker(devices=device())
        done = run("map", "check", points, "--device", server.url)
    assert (done.code, done.err) == (0, "")
    assert done.out.endswith("20 of 20 points can be read, in 1 request\n")
    assert len(server.transactions) == 1


def test_a_device_that_refuses_everything(points: Path) -> None:
    with ServerMaker() as maker:
        server = maker(devices=device(*range(20)))
        done = run("map", "check", points, "--device", server.url)
    assert done.code == 1
    assert "all 20 points refused: " in done.err
    assert done.err.count("\n") == 1
    assert len(server.transactions) <= 40


def test_a_device_that_is_silent_or_busy(points: Path) -> None:
    with ServerMaker() as maker:
        silent = maker(faults={None: [Fault("no_answer")]})
        done = run("map", "check", points, "--device", silent.url, "--timeout", "0.1")
        assert done.code == 1
        assert "no answer" in done.err
        busy = maker(faults={None: [Fault("exception", code=6)]})
        done = run("map", "check", points, "--device", busy.url)
        assert done.code == 1
        assert "server device busy" in done.err
        assert len(busy.transactions) == 1


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        ("-u 17", "--unit"),
        ("-b 9600", "--baudrate"),
        ("--ca a.pem", "--ca"),
        ("--native", "--native"),
    ],
)
def test_options_of_requests_need_a_device(points: Path, typed: str, name: str) -> None:
    done = run("map", "check", points, *typed.split())
    assert (done.code, done.out) == (2, "")
    assert f"{name} needs --device" in done.err
