"""
Blocks of shell, as somebody would type them.

In ``console`` every command stands behind ``$ ``, with what it prints (standard output and error)
below it: ``...`` is anything, and a line of it any number of lines. A command that ends with ``&``
runs until the document ends; what is below it must come before the next one is typed. ``^C`` in a
line of its own interrupts the command after what stands above it. What prints nothing must succeed.
In ``sh`` every line is a command, which must succeed, whatever it prints.

bash runs the commands; a ``libmodbus-py`` without anything that is the shell's is forked from a
process that has imported the package, which takes a tenth of the time.
"""

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.docs.python_blocks import matches
from tests.support.commands import PAGE_TOKEN, Started

Process = subprocess.Popen[bytes] | Started

PATIENCE = 30.0  # seconds that a command may take: the machine may be busy

_TYPED = re.compile(r"^\$ (.*(?:(?<=\\)\n> .*)*)\n?((?:(?!\$ ).*\n?)*)", re.MULTILINE)

# What of a shell the next command finds: variables, folder, $?.
_KEEP = """code=$?
env -0 >{state}
exit $code"""

# What has a meaning in a shell, even within double quotes.
_OF_THE_SHELL = re.compile(r"[$`*~\\\[]")
_PUNCTUATION = set("();<>|&")


@dataclass(frozen=True)
class Command:
    """
    `text`: what is typed; `expected`: what it prints, or None if nobody says; `line`: where it
    stands in its block, from 1.
    """

    text: str
    expected: str | None
    line: int

    @property
    def stays(self) -> bool:
        return self.text.endswith("&")

    @property
    def interrupted(self) -> bool:
        return self.expected is not None and self.expected.endswith("^C\n")


def _plain(text: str) -> list[str]:
    """Return the arguments of a libmodbus-py that needs no shell; otherwise nothing."""
    words = shlex.shlex(text, posix=True, punctuation_chars=True)
    words.whitespace_split, words.commenters = True, ""
    name, *arguments = words
    if name != "libmodbus-py" or _OF_THE_SHELL.search(text):
        return []
    return [] if any(set(word) <= _PUNCTUATION for word in arguments if word) else arguments


def of_console(source: str) -> Iterator[Command]:
    """Cut a block with prompts. Lines that go on end with a backslash, their next begins with >."""
    for typed in _TYPED.finditer(source):
        line = source.count("\n", 0, typed.start()) + 1
        yield Command(re.sub(r"\\\n> ", "", typed[1]), typed[2], line)


def of_sh(source: str) -> Iterator[Command]:
    for typed in re.finditer(r"^(?!#).*\S.*(?:(?<=\\)\n.*)*", source, re.MULTILINE):
        line = source.count("\n", 0, typed.start()) + 1
        yield Command(re.sub(r"\s+#\s.*", "", typed[0].replace("\\\n", "")), None, line)


class Shell:
    """
    Types commands in a folder, and keeps what stays. `folder`: where it begins; ``cd`` and
    ``export`` hold for what follows; `normalize`: puts the name that documents have for it into
    what was printed.
    """

    def __init__(self, folder: Path, normalize: Callable[[str], str]) -> None:
        self._normalize = normalize
        self._state = folder / ".shell"
        self._code = 0
        self._staying: list[Process] = []
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        self._environment = {
            **os.environ,
            "PATH": path,
            "PWD": str(folder),
            "PYTHONUNBUFFERED": "1",
            "COLUMNS": "100",
            **PAGE_TOKEN,  # a reader has a terminal, on which a new one is printed
            # Not those of whoever runs these tests, and without a plugin that takes long to load.
            "PYTEST_ADDOPTS": "-p no:hypothesispytest",
        }

    def close(self) -> None:
        """Interrupt commands that still run; they must end."""
        for process in self._staying:
            _interrupt(process)

    def type(self, command: Command) -> None:
        output = self._state.with_name(f".output-{time.monotonic_ns()}")
        with output.open("wb") as writing:
            process = self._start(command, writing.fileno())
        if command.stays:
            self._staying.append(process)
            self._await(process, output, command.expected or "")
        elif command.interrupted:
            self._await(process, output, (command.expected or "").removesuffix("^C\n"))
            _interrupt(process)
        else:
            self._finish(process, output, command)

    def _start(self, command: Command, output: int) -> Process:
        text = command.text.rstrip("& ")
        if words := _plain(text):
            return self._fork(words, output)
        if command.stays or command.interrupted:
            script = f"exec {text}"
        else:
            script = f"(exit {self._code})\n{text}\n{_KEEP.format(state=self._state)}"
        return subprocess.Popen(
            ["bash", "-c", script],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=self._environment,
            cwd=self._environment["PWD"],
            start_new_session=True,
        )

    def _fork(self, words: list[str], output: int) -> Started:
        return Started(
            *words,
            stdout=output,
            stderr=output,
            environment=self._environment,
            folder=Path(self._environment["PWD"]),
            new_session=True,
        )

    def _await(self, process: Process, output: Path, text: str) -> None:
        """Wait until the command has printed so much."""
        end = time.monotonic() + PATIENCE
        while not matches(f"{self._pattern(text)}...", self._read(output)):
            assert process.poll() is None, f"ended: {self._read(output)}"
            assert time.monotonic() < end, f"printed {self._read(output)!r}, not {text!r}"
            time.sleep(0.02)

    def _finish(self, process: Process, output: Path, command: Command) -> None:
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise AssertionError(f"does not end: {self._read(output)}") from None
        self._code = code
        if self._state.exists():
            pairs = self._state.read_text().split("\0")[:-1]
            self._environment = dict(pair.split("=", 1) for pair in pairs)
        printed = self._read(output)
        assert code == 0 or command.expected, f"exit code {code}: {printed}"
        if command.expected is None or matches(self._pattern(command.expected), printed):
            return
        # No assert: pytest may rewrite it, and would indent the lines.
        raise AssertionError(f"printed:\n{printed}\nand not:\n{command.expected}")

    def _read(self, output: Path) -> str:
        return self._normalize(output.read_text(errors="replace"))

    def _pattern(self, text: str) -> str:
        """A whole line of ``...`` stands for text with its line end."""
        return re.sub(r"^\.\.\.\n", "...", text, flags=re.MULTILINE)


def _interrupt(process: Process) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
