"""
Instructions of a process for one request: ./run bench --instructions

Each case runs with 500 and with 2500 requests in a process of its own, in which valgrind counts
the instructions, those of the kernel not among them; the difference is divided by the requests.
These figures hardly depend on how fast or busy the machine is, so that CI can keep ours from
growing: --check compares them with those in bench/instructions.json, which --update writes.
"""

from __future__ import annotations

import compileall
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import libmodbus_py
from bench.cells import (
    C_CLIENT,
    C_SERVER,
    C_TCP_SERVER,
    OUR_SERVER,
    OURS,
    READ_HOOK_SERVER,
    C,
    Peer,
    Tools,
)
from bench.children import HERE, Child, Failed, compile_all, python
from bench.memory import connect
from bench.report import grid, number

FEW, MANY = 500, 2500
"""Requests."""

LIMIT = 1.05
"""The most of the number in the tree that --check accepts."""

PATIENCE_S = 300
NUMBERS = HERE / "instructions.json"
# Of two runs that compile different files, the difference would not be that of requests.
ENVIRONMENT = {"PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"}
VALGRIND = [
    *("env", *(f"{name}={value}" for name, value in ENVIRONMENT.items()), "valgrind"),
    *("--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"),
]


class Count(NamedTuple):
    """The instructions and requests of one process."""

    instructions: int
    requests: int


class Case(NamedTuple):
    """A row: the command for so many requests, and the package that it needs, or `C`."""

    name: str
    run: Callable[[Tools, int], Count]
    package: str = OURS

    @property
    def is_present(self) -> bool:
        return self.package == C or find_spec(self.package) is not None

    @property
    def is_ours(self) -> bool:
        return self.package.partition(".")[0] == OURS


# --- processes ----------------------------------------------------------------------------


class CountedProcess(Child):
    """A process whose instructions valgrind counts."""

    def __init__(self, command: list[str], log: Path) -> None:
        self._log = log
        super().__init__([*VALGRIND, f"--log-file={log}", *command])

    def instructions(self) -> int:
        """Wait for the end of the process; return its instructions."""
        self._process.communicate(timeout=PATIENCE_S)
        refs = re.search(r"I +refs: +([\d,]+)", self._log.read_text())
        if refs is None:
            raise Failed(self._last_words())
        return int(refs[1].replace(",", ""))

    def interrupt(self) -> None:
        self._process.send_signal(signal.SIGTERM)


@contextmanager
def under_valgrind(command: list[str]) -> Iterator[CountedProcess]:
    with (
        tempfile.TemporaryDirectory() as folder,
        CountedProcess(command, Path(folder, "log")) as child,
    ):
        yield child


@contextmanager
def server(tools: Tools, peer: Peer = C_TCP_SERVER) -> Iterator[str]:
    """Run a server whose instructions are not counted; yield its port."""
    with Child(tools.command(peer, "servers.py")) as child:
        yield child.read_line()


def c_client(tools: Tools, port: str, requests: int) -> list[str]:
    return [str(tools.programs / "client"), "tcp", port, str(requests), "10"]


def read_all(client: Child) -> None:
    """Have the client in C, which reads for so many seconds, read all its blocks once."""
    client.read_line(PATIENCE_S)
    result = client.order("0.000001", PATIENCE_S)
    if "failed" in result:
        raise Failed(result["failed"])


# --- what is counted ----------------------------------------------------------------------


def client(name: str, tools: Tools, requests: int) -> Count:
    with (
        server(tools) as port,
        under_valgrind(python("programs.py", name, port, str(requests))) as child,
    ):
        sent = int(child.read_line(PATIENCE_S))
        return Count(child.instructions(), sent)


def client_in_c(tools: Tools, requests: int) -> Count:
    with server(tools) as port, under_valgrind(c_client(tools, port, requests)) as child:
        read_all(child)
        return Count(child.instructions(), requests)


def server_of(peer: Peer, tools: Tools, requests: int) -> Count:
    return count_server(tools.command(peer, "servers.py"), tools, requests)


def gateway(tools: Tools, requests: int) -> Count:
    command = [sys.executable, "-m", "libmodbus_py", "gateway", "tcp://127.0.0.1:0", "--to"]
    with server(tools) as port:
        return count_server([*command, f"tcp://127.0.0.1:{port}"], tools, requests)


def count_server(command: list[str], tools: Tools, requests: int) -> Count:
    with under_valgrind(command) as child:
        port = child.read_line(PATIENCE_S).rpartition(":")[2]
        # The first request imports modules, for longer than libmodbus's client waits.
        with ExitStack() as stack:
            if connect(stack, int(port), PATIENCE_S) is None:
                raise Failed("no answer")
        with Child(c_client(tools, port, requests)) as asking:
            read_all(asking)
        child.interrupt()
        return Count(child.instructions(), requests)


def program(title: str, name: str, package: str = OURS) -> Case:
    return Case(title, partial(client, name), package)


CASES = [
    program("contexts.TcpContext", "context", "libmodbus_py.contexts"),
    program("Client", "client"),
    program("Client.execute_many, 16 in flight", "execute-many"),
    program("AsyncClient", "async"),
    program("AsyncClient.execute_many, 16 in flight", "async-execute-many"),
    program("AsyncClient, 16 gathered", "async-gather"),
    Case(OUR_SERVER, partial(server_of, Peer(OUR_SERVER, "ours"))),
    Case(READ_HOOK_SERVER, partial(server_of, Peer(READ_HOOK_SERVER, "ours-with-read-hook"))),
    Case("gateway, TCP to TCP", gateway),
    program("fleet, poll of 10 points", "fleet"),
    Case(C_CLIENT, client_in_c, C),
    program("pylibmodbus", "pylibmodbus", "pylibmodbus"),
    program("pyModbusTCP", "pyModbusTCP", "pyModbusTCP"),
    program("pymodbus", "pymodbus", "pymodbus"),
    program("pymodbus, async", "pymodbus-async", "pymodbus"),
    Case(C_SERVER, partial(server_of, C_TCP_SERVER), C),
    Case(
        "pymodbus, server", partial(server_of, Peer("pymodbus", "pymodbus", "pymodbus")), "pymodbus"
    ),
]


def of_one_request(case: Case, tools: Tools, few: int = FEW, many: int = MANY) -> int:
    """
    Return the instructions for a request.

    Raises:
        Failed: a process could not do what it was told.
    """
    less, more = case.run(tools, few), case.run(tools, many)
    return round((more.instructions - less.instructions) / (more.requests - less.requests))


def measure(cases: list[Case]) -> dict[str, int | str]:
    """Return the instructions of each case for a request, or why there are none."""

    def figure(case: Case) -> int | str:
        try:
            return of_one_request(case, tools)
        except (Failed, subprocess.TimeoutExpired) as failure:
            return str(failure)

    for source in (HERE, Path(libmodbus_py.__file__).parent):
        compileall.compile_dir(source, quiet=1)
    with tempfile.TemporaryDirectory() as folder:
        tools = Tools(Path(folder))
        compile_all(tools.programs)
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            figures = list(pool.map(figure, cases))
    return {case.name: figure for case, figure in zip(cases, figures, strict=True)}


# --- the numbers in the tree --------------------------------------------------------------


def here() -> str:
    """Return the versions and the processor that figures depend on, in the form of the file."""
    return f"{platform.python_implementation()} {platform.python_version()}, {platform.machine()}"


def in_tree() -> dict[str, dict[str, int]]:
    numbers: dict[str, dict[str, int]] = json.loads(NUMBERS.read_text())
    return numbers


def growth(expected: Mapping[str, int], measured: Mapping[str, int | str]) -> list[str]:
    """Return a sentence for each case that costs more than the numbers in the tree allow."""
    sentences = []
    for name in {**expected, **measured}:
        now, before = measured.get(name, "not measured"), expected.get(name)
        if isinstance(now, str):
            sentences.append(f"{name}: {now}")
        elif before is None:
            sentences.append(f"{name}: {now:,} instructions, and no number in the tree")
        elif now > LIMIT * before:
            sentences.append(
                f"{name}: {now:,} instructions, {now / before - 1:.1%} above {before:,}"
            )
    return sentences


def table(measured: Mapping[str, int | str], expected: Mapping[str, int]) -> str:
    rows = []
    for name, now in measured.items():
        before = expected.get(name)
        if isinstance(now, str):
            rows.append([name, "fails", "", now])
        else:
            ratio = number(now / before if before else None, ".3f")
            rows.append([name, number(now), number(before), ratio])
    return grid(["instructions for one request", here(), "in the tree", "ratio"], rows)


def main(*, check: bool, update: bool) -> int:
    """Measure and print; return 1 if `check` finds growth, or if `update` has nothing to write."""
    numbers = in_tree()
    expected = numbers.get(here(), {})
    if check and not expected:
        print(f"not checked: {NUMBERS.name} has no numbers for {here()}; --update writes them")
        return 0
    cases = [case for case in CASES if case.is_present and (case.is_ours or not check)]
    measured = measure(cases)
    print(table(measured, expected))
    ours = {case.name: measured[case.name] for case in cases if case.is_ours}
    if check and (sentences := growth(expected, ours)):
        print(f"more than {LIMIT - 1:.0%} above the numbers in the tree:", *sentences, sep="\n")
        print("./run bench --instructions --update accepts what is measured")
        return 1
    if update:
        figures = {name: now for name, now in ours.items() if isinstance(now, int)}
        if figures != ours:
            print("nothing is written, because a case fails")
            return 1
        NUMBERS.write_text(json.dumps({**numbers, here(): figures}, indent=1) + "\n")
    return 0
