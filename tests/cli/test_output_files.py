"""
--csv FILE and --json FILE: what is in the file after a success, a failure and on a full disk; and
what a terminal shows meanwhile.
"""

import contextlib
import os
import resource
from collections.abc import Iterator
from pathlib import Path

from libmodbus_py import Device, Mapping, Server
from tests.support.cases import each_case
from tests.support.commands import on_terminal, run

FULL_BYTES = 100

DECODED = Path(__file__).parents[1] / "tools" / "listener" / "decoded.pcapng"


@contextlib.contextmanager
def small_files() -> Iterator[None]:
    """Let files grow to some bytes only, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@each_case(
    "words",
    [
        "read 127.0.0.1:1 hr 0 --json",
        "read 127.0.0.1:1 hr 0 --csv",
        "identify 127.0.0.1:1 --json",
        "diagnose 127.0.0.1:1 --json",
        "sunspec 127.0.0.1:1 --json",
        "listen /dev/no-such-port --json",
    ],
)
def test_a_command_that_fails_leaves_no_empty_file(words: str, tmp_path: Path) -> None:
    for _ in range(2):
        result = run(*words.split(), tmp_path / "log.json")
        assert (result.code, result.out) == (1, "")
        assert "exists" not in result.err
        assert [*tmp_path.iterdir()] == []


@each_case("option", ["--csv", "--json"])
def test_output_goes_into_a_new_file(url: str, tmp_path: Path, option: str) -> None:
    path = tmp_path / f"log{option.replace('--', '.')}"
    result = run("read", url, option, path, "hr", 0)
    assert result == (0, "", "")
    assert path.read_text().count("\n") == (2 if option == "--csv" else 1)
    again = run("read", url, "hr", 1, option, path)
    assert again.code == 2
    assert str(path) in again.err
    assert path.read_text().count("\n") == (2 if option == "--csv" else 1)
    other = tmp_path / f"without a suffix{option}"
    assert run("read", url, "hr", 0, f"{option}={other}").code == 0
    assert other.read_text()
    bare = tmp_path / f"bare{option}"  # a path, which says enough
    assert run("read", url, option, bare, "hr", 0).code == 0
    assert bare.read_text()


def test_csv_continues_a_file_of_the_same_columns(url: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.touch()  # an empty file has no header with other columns
    words = ("read", url, "hr", 0, 2)
    for _ in range(2):
        assert run(*words, "--csv", path) == (0, "", "")
    heading, *rows = path.read_text().splitlines()
    assert heading == "time,hr 0,hr 1,error"
    assert [row.count(",") for row in rows] == [3, 3]
    path.write_text(f"{heading}\n2026-01-01T00:00:00Z,1")  # the power failed meanwhile
    assert run(*words, "--watch", "0.01", "--count", "2", "--csv", path).code == 0
    assert [row.count(",") for row in path.read_text().splitlines()] == [3, 1, 3, 3]


def test_csv_refuses_a_file_with_other_columns(url: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,hr 0,error\n")
    both = "log.csv has the columns 'time,hr 0,error', and not 'time,hr 0,hr 1,error': name another"
    result = run("read", url, "hr", 0, 2, "--csv", path)
    assert (result.code, both in result.err) == (2, True)
    assert "exists" in run("read", url, "hr", 0, "--json", path).err
    assert path.read_text() == "time,hr 0,error\n"
    os.mkfifo(tmp_path / "fifo.csv")  # which would be waited for
    assert "exists" in run("read", url, "hr", 0, "--csv", tmp_path / "fifo.csv").err


def test_rows_beyond_a_full_disk_do_not_spoil_earlier_rows(url: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    before = "time,hr 0,error\n" + "2026-01-01T00:00:00Z,1,\n" * 3
    path.write_text(before)
    with small_files():
        result = run("read", url, "hr", 0, "--csv", path)
    assert (result.code, result.err) == (1, f"libmodbus-py: {path}: File too large\n")
    assert path.read_text() == before


@each_case("option", ["--csv", "--json"])
def test_arguments_after_the_option_are_not_taken_for_files(url: str, option: str) -> None:
    assert run("read", option, url, "hr", 0).out
    assert run("read", url, option, "hr", 0).out
    assert run("read", url, "hr", 0, option).out


@each_case("form", ["--csv", "--json"])
def test_an_error_about_a_full_disk_names_the_file(url: str, form: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{form.replace('--', '.')}"
    with small_files():
        result = run("read", url, "hr", 0, 9, "--watch", "0.01", form, path)
    assert (result.code, result.out) == (1, "")
    assert result.err == f"libmodbus-py: {path}: File too large\n"
    if form == "--csv":
        assert path.read_text().endswith("\n")
    else:  # not even one line fits
        assert not path.exists()


def test_a_map_that_does_not_fit_on_the_disk_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "found.csv"
    server = Server(Device(Mapping(coils=50)))
    with server.background("tcp://127.0.0.1:0") as running, small_files():
        result = run("map", "from-device", running.urls[0], "-o", path)
    assert result == (1, "", f"libmodbus-py: {path}: File too large\n")
    assert not path.exists()


def test_a_terminal_shows_a_watch_that_is_written_to_a_file(url: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    words = ("read", url, "hr", 0, "--watch", "0.02", "--count", "3", "--csv", path)
    with on_terminal(*words, columns=200) as terminal:
        text = terminal.read_to_end()
    assert terminal.process.wait() == 0
    assert "1 polls" in text
    assert text.endswith(f"3 polls in {path}\r\n")
    assert path.read_text().count("\n") == 4


def test_a_terminal_shows_failures_of_a_watch_of_a_file(device: str, tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    words = ("read", "127.0.0.1:1", "hr", 0, "--watch", "0.02", "--count", "2", "--json", path)
    with on_terminal(*words, columns=200) as terminal:
        text = terminal.read_to_end()
    assert "1 failed" in text
    assert "Connection refused" in text
    result = run(*words[:-1], tmp_path / "again.json")
    assert (result.code, result.out) == (1, "")
    assert result.err.count("Connection refused") == 1  # said once, not at each poll
    words = ("hr", 0, "hr", 99, "--watch", "0.02", "--count", "3", "--csv", tmp_path / "a.csv")
    result = run("read", device, *words)
    assert (result.code, result.out, result.err.count("exception 2")) == (0, "", 1)


PRINTING = [
    "--version",
    "--help",
    "demo",
    "read URL hr 0",
    "read URL hr 0 --json",
    "read URL hr 0 --watch 0.01 --count 3",
    "write URL hr 0 5 --dry-run",
    "identify URL",
    "diagnose URL",
    "raw URL 03 00 00 00 01",
    "map list",
    "map check meter",
    "map class meter",
    "serve --example",
    f"listen {DECODED}",
]
"""What is typed to print something."""


@each_case("words", PRINTING)
def test_an_output_that_is_full_or_closed_ends_the_command(url: str, words: str) -> None:
    typed = words.replace("URL", url).split()
    with open("/dev/full", "w") as full:
        result = run(*typed, out=full)
    assert result == (1, "", "libmodbus-py: standard output: No space left on device\n")
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w") as pipe:
        result = run(*typed, out=pipe)
    assert (result.code, result.err) == (1, "")
