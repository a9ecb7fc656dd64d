"""What a command imports before it starts, and the demonstration."""

import os
import socket
import sys
from pathlib import Path

import pytest

from tests.cli.serving import serving
from tests.support.commands import PROGRAM, run
from tests.support.programs import run_to_end


def modules_after(*arguments: str) -> set[str]:
    """Return the modules that were imported when the command ends."""
    program = (
        "import atexit, sys\n"
        "from libmodbus_py.cli.main import main\n"
        "atexit.register(lambda: print('MODULES', *sys.modules, file=sys.stderr))\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    result = run_to_end(sys.executable, "-c", program, *arguments)
    return set(result.stderr.partition("MODULES ")[2].split())


# Modules that take long to import. From Python 3.14 on, argparse itself brings dataclasses.
SLOW = {"asyncio", "ssl", "socket", "logging"}
SLOW |= {"dataclasses"} if sys.version_info < (3, 14) else set()


@pytest.mark.parametrize(
    "arguments", [["--version"], ["--help"], [], ["reed"], ["--unit", "3"]], ids=" ".join
)
def test_commands_without_a_client_import_none(arguments: list[str]) -> None:
    modules = modules_after(*arguments)
    folders = {name.split(".")[1] for name in modules if name.startswith("libmodbus_py.")}
    # A word that is not a command is compared with those that are.
    assert folders - ({"protocol"} if arguments[:1] in (["reed"], ["--unit"]) else set()) == {
        "cli",
        "late",
        "version",
    }
    assert "argparse" in modules
    assert not modules & SLOW


@pytest.mark.parametrize("arguments", [["read"], ["raw", "-b", "x"], ["write", "h", "--retries"]])
def test_wrong_usage_imports_no_client(arguments: list[str]) -> None:
    modules = modules_after(*arguments)
    ports = {name for name in modules if name.startswith("libmodbus_py.ports.")}
    assert ports == {"libmodbus_py.ports.options", "libmodbus_py.ports.schemes"}
    assert not any(name.startswith("libmodbus_py.client") for name in modules)
    assert not modules & SLOW


def test_help_imports_the_defaults_and_no_client() -> None:
    modules = modules_after("write", "--help")
    assert not any(name.startswith("libmodbus_py.client") for name in modules)
    assert not modules & {"asyncio", "ssl", "logging"}


def test_a_read_imports_the_blocking_client_alone() -> None:
    modules = modules_after("read", "127.0.0.1:1", "holding", "0")
    assert "libmodbus_py.client.blocking" in modules
    assert not modules & {"asyncio", "ssl", "logging", "csv", "datetime", "json"}
    assert not modules & {"libmodbus_py.server", "libmodbus_py.protocol.pdu.writes"}
    assert not modules & {"libmodbus_py.protocol.pdu.files", "shutil", "textwrap"}
    # The rules of RTU bring every function code; a read prints no CSV, and asks no package.
    assert not modules & {"libmodbus_py.protocol.rtu", "libmodbus_py.files", "importlib.metadata"}
    # One item needs neither a plan nor, without a type, the types of values.
    assert not any(name.startswith("libmodbus_py.maps") for name in modules)
    assert not modules & {"libmodbus_py.protocol.values", "libmodbus_py.protocol.value_types"}


def test_the_option_version_prints_the_version() -> None:
    result = run_to_end(*PROGRAM, "--version")
    assert result.stdout == "libmodbus-py 0.1.0\n"


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(closed: str) -> None:
    line = f"'{sys.executable}' -m libmodbus_py --version {closed}"
    result = run_to_end("sh", "-c", line)
    assert result.returncode == 0
    assert result.stderr == ""


def test_ctrl_c_during_the_start_shows_no_traceback() -> None:
    """From the first line of the package on; earlier tracebacks are Python's own."""
    program = (
        "import os, signal, sys, threading, time\n"
        "def interrupt():\n"
        "    while 'libmodbus_py.cli.output' not in sys.modules: pass\n"
        "    time.sleep(float(sys.argv[1])); os.kill(os.getpid(), signal.SIGINT)\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell may ignore it
        "threading.Thread(target=interrupt, daemon=True).start()\n"
        "from libmodbus_py.cli.main import main\n"
        "sys.exit(main(['read', sys.argv[2], 'holding', '0']))"
    )
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"tcp://127.0.0.1:{silent.getsockname()[1]}?timeout=20"
        for delay in ("0.001", "0.005", "0.02", "0.1", "0.5"):
            result = run_to_end(sys.executable, "-c", program, delay, url)
            assert (result.returncode, result.stdout, result.stderr) == (130, "", "")


@pytest.mark.parametrize(("cause", "code"), [(KeyboardInterrupt(), 130), (None, 1)])
def test_ctrl_c_that_became_another_error_ends_like_ctrl_c(monkeypatch, cause, code) -> None:
    """As in `__set_name__`, while a class is made; a mistake of ours is one line."""

    def fail(_: object) -> None:
        raise RuntimeError("Error calling __set_name__") from cause

    monkeypatch.setattr("libmodbus_py.cli.commands.parse_arguments", fail)
    result = run("read")
    assert result.code == code
    assert result.err.startswith("libmodbus-py: unexpected RuntimeError" if code == 1 else "")
    assert result.err.count("\n") == (code == 1)


def test_characters_that_the_terminal_cannot_show_are_written_in_ascii() -> None:
    program = (
        "import sys; from libmodbus_py.cli import output; output.prepare(); print('21.5 \\u00b0C')"
    )
    plain = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
    result = run_to_end(sys.executable, "-X", "utf8=0", "-c", program, env=plain)
    assert result.stdout == "21.5 \\u00b0C\n"


def test_demo_shows_every_example_on_every_line() -> None:
    result = run("demo")
    assert result.code == 0
    assert result.err == ""
    assert "\x1b" not in result.out
    examples = result.out.partition("To try next")[0]
    assert max(map(len, examples.splitlines())) <= 80
    for line in (
        "00 01 00 00 00 06 06 03 00 7A 00 03",
        "06 03 06 03 15 30 39 FD C9 55 7E",
        r":0603007A00037A\r\n",
        r":11140C05060DFE0020050633CD00404E\r\n",
        r":0D86026B\r\n",
    ):
        assert line in result.out
    assert result.out.count("[789, 12345, 64969]") == 3
    assert result.out.count("[[3582, 32], [13261, 64]]") == 3
    assert result.out.count("refused: illegal data address (exception 2)") == 3


@pytest.mark.parametrize("is_found", [True, False])
def test_the_commands_that_demo_prints_at_its_end_work_in_any_folder(
    is_found: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shutil.which", lambda name: name if is_found else None)
    program = ["libmodbus-py"] if is_found else [sys.executable, "-m", "libmodbus_py"]
    lines = [line.split() for line in run("demo").out.partition("To try next")[2].splitlines()]
    assert [words[: len(program)] for words in lines[1:]] == [program] * 3
    serve, read, identify = [words[len(program) :] for words in lines[1:]]
    assert {words[1] for words in (serve, read, identify)} == {"127.0.0.1:1502"}
    with serving("serve", "127.0.0.1:0", *serve[2:]) as (_, url):
        result = run("read", url, *read[2:])
        assert (result.code, result.err) == (0, "")
        assert "voltage" in result.out
        result = run("identify", url, *identify[2:])
        assert (result.code, result.err) == (0, "")
        assert "METER" in result.out
    assert [*tmp_path.iterdir()] == []
