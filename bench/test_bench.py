"""
The benchmark: its programs in C compile without a warning, a short run of all of it returns
numbers, and so does the table of attacks. CI runs this file; `./run test` does not.
"""

from __future__ import annotations

import importlib
import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from bench import gateway, instructions
from bench.cells import C_CLIENT, Tools
from bench.children import compile_all
from tests.support.attacks import ATTACKS

BENCH = Path(__file__).parent
PROGRAMS = sorted(BENCH.glob("*.c"))


@pytest.mark.parametrize("source", PROGRAMS, ids=lambda source: source.stem)
def test_program_compiles_without_a_warning(source: Path, tmp_path: Path) -> None:
    command = ["gcc", "-O2", "-Wall", "-Wextra", "-Werror", "-o", tmp_path / "program", source]
    subprocess.run([*command, "-lmodbus"], check=True)


def run_bench(*arguments: object, module: str = "bench") -> str:
    command = [sys.executable, "-m", module, *map(str, arguments)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=BENCH.parent)
    return done.stdout


@pytest.mark.timeout(600)  # one program starts all the others
def test_short_run_measures_whatever_is_installed(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    text = run_bench("--rounds", 1, "--seconds", 0.01, "--save", file)
    report = json.loads(file.read_text())
    cells = {(cell["section"], cell["variant"], cell["name"]): cell for cell in report["cells"]}

    assert {section for section, _, _ in cells} == {
        "blocking",
        "asyncio",
        "bulk",
        "servers",
        "limit",
    }
    for name in ("libmodbus, client in C", "Client", "pymodbus"):
        assert_is_measured(cells["blocking", "TCP", name])
    for load in ("1 x 1", "8 x 16", "1000 x 1"):
        assert_is_measured(cells["servers", load, "libmodbus, server in C"])
        assert_is_measured(cells["servers", load, "Server"])
    assert cells["servers", "8 x 16", "pymodbus"]["note"] == "answers 1 of 16"
    assert report["memory"]["Server"]["connections"] == 1000
    assert set(report["tls"]["requests"]) == {"1 x 1", "8 x 1", "100 x 1", "1 x 16", "8 x 16"}
    assert all(secure > 0 for _, secure in report["tls"]["requests"].values())
    assert all(cost > 0 for cost in report["tls"]["handshakes"].values())
    assert report["startup"]["libmodbus-py, one read"] > report["startup"]["Python, nothing"] > 0
    assert len(report["targets"]) == text.count(">= ")


def test_two_states_of_the_package_are_compared(tmp_path: Path) -> None:
    """Here the package with itself: in turns, and with numbers that were saved."""
    file = tmp_path / "bench.json"
    short = ("--only", "asyncio", "--rounds", 1, "--seconds", 0.01)
    checkout = BENCH.parent
    lines = (
        "asyncio, to our server, AsyncClient ",
        "asyncio, to libmodbus's server, AsyncClient, 64",
    )

    in_turns = run_bench(*short, "--before", checkout)
    alone = run_bench(*short, "--package", checkout, "--save", file)
    with_saved = run_bench(*short, "--against", file)

    for text in (in_turns, with_saved):
        table = text.partition("after / before")[2]
        assert all(line in table for line in lines)
        assert "before" not in table.partition("\n")[2]
    assert "AsyncClient, before" in in_turns
    assert "after / before" not in alone
    # The peers that are in both show how far the machine is to be trusted.
    assert "libmodbus, client in C" in with_saved.partition("after / before")[2]


def assert_is_measured(cell: dict[str, object]) -> None:
    assert cell["note"] == ""
    assert isinstance(cell["rate"], float)
    assert cell["rate"] > 0
    assert len(cell["rounds"]) == 1  # type: ignore[arg-type]


def test_what_is_not_installed_is_left_out_and_said() -> None:
    text = run_bench("--only", "limit", "--rounds", 1, "--seconds", 0.01)
    for package in ("pylibmodbus", "pyModbusTCP", "umodbus", "minimalmodbus"):
        assert (f"left out, not installed: {package}\n" in text) == (find_spec(package) is None)


def test_the_table_of_attacks_is_printed() -> None:
    name = ATTACKS[-1].name
    text = run_bench("0.2", "--only", name, module="bench.attacks")
    row = next(line for line in text.splitlines() if line.startswith(name))
    requests, lost = row.removeprefix(name).split()[:2]
    assert int(requests) > 0
    assert lost == "0"


def test_gateways_are_measured(capsys: pytest.CaptureFixture[str]) -> None:
    gateway.rates(500)
    gateway.silent_unit(20)
    gateway.beside_silent_unit(40)
    gateway.late_unit(40)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert "'wrong': 0" in lines[-1]


def test_instructions_of_ours_may_not_grow(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = {instructions.here(): {"Client": 60_000, "AsyncClient": 120_000}}
    monkeypatch.setattr(instructions, "in_tree", lambda: tree)

    def check(measured: dict[str, int | str]) -> tuple[int, list[str]]:
        cases = [case for case in instructions.CASES if case.name in measured]
        monkeypatch.setattr(instructions, "CASES", cases)
        monkeypatch.setattr(instructions, "measure", lambda cases: measured)
        status = instructions.main(check=True, update=False)
        return status, capsys.readouterr().out.partition("in the tree:\n")[2].splitlines()[:-1]

    assert check({"Client": 63_000, "AsyncClient": 1}) == (0, [])
    for measured, sentence in (
        ({"Client": 63_001, "AsyncClient": 1}, "Client: 63,001 instructions, 5.0% above 60,000"),
        ({"Client": 1, "AsyncClient": "did nothing"}, "AsyncClient: did nothing"),
        ({"Client": 1}, "AsyncClient: not measured"),
    ):
        assert check(measured) == (1, [sentence])
    assert instructions.growth({}, {"Server": 1}) == [
        "Server: 1 instructions, and no number in the tree"
    ]


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
def test_instructions_are_counted(tmp_path: Path) -> None:
    compile_all(tmp_path)
    figures = {
        case.name: instructions.of_one_request(case, Tools(tmp_path), 20, 60)
        for case in instructions.CASES
        if case.name in (C_CLIENT, "Client")
    }
    assert 500 < figures[C_CLIENT] < 5_000
    assert 20_000 < figures["Client"] < 200_000


@pytest.mark.parametrize(
    "file", sorted(Path(__file__).parent.glob("*.py")), ids=lambda file: file.stem
)
def test_each_file_of_the_benchmark_can_be_imported(file: Path) -> None:
    if file.stem == "picture":
        pytest.importorskip("matplotlib")
    if not file.stem.startswith("__"):
        importlib.import_module(f"bench.{file.stem}")
