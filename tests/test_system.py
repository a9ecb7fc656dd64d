"""What only Linux has: the package works without it, and what takes its place does the same."""

from __future__ import annotations

import ast
import fcntl
import os
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

import libmodbus_py
from libmodbus_py.system import (
    DescriptorPoller,
    Flag,
    SelectorPoller,
    lock_file,
    make_poller,
    most_descriptors,
)

ELSEWHERE = Path(__file__).parent / "support" / "elsewhere.py"

COMMON = {"server", "gateway", "listener", "page", "closing", "commands"}
"""What works on every system; its check in the program is named so."""


@pytest.mark.parametrize(
    ("level", "more"), [("macos", {"serial", "children"}), ("bare", {"no_serial"})]
)
def test_the_package_works_without_what_only_linux_has(level: str, more: set[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(ELSEWHERE), level],
        env=os.environ | {"PYTHONPATH": str(ELSEWHERE.parents[2])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    works = {line.split()[0] for line in done.stdout.splitlines() if line.endswith(" works")}
    assert works == COMMON | more
    assert done.stderr == ""


# Calls and constants that other systems lack; each is named in one file.
ONLY_LINUX = {
    *("eventfd", "epoll", "TCP_QUICKACK", "TCP_KEEPIDLE", "CLOCK_BOOTTIME", "register_at_fork"),
    *("EKEYREJECTED", "SOCK_CLOEXEC", "getrlimit", "F_DUPFD_CLOEXEC", "pipe2", "accept4"),
}


def test_one_file_alone_names_what_only_linux_has() -> None:
    package = Path(libmodbus_py.__file__).parent
    found = {
        f"{path.relative_to(package)}: {node.attr}"
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and node.attr in ONLY_LINUX
    }
    assert {each.partition(":")[0] for each in found} == {"system.py"}


ONLY_POSIX = {"resource", "fcntl", "termios", "tty", "pty"}


def test_modules_that_only_posix_has_are_imported_where_they_are_used() -> None:
    """Serial ports need them; all else works without them."""
    package = Path(libmodbus_py.__file__).parent
    found = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Import) and {each.name for each in node.names} & ONLY_POSIX
    }
    assert found == {"ports/serial.py"}


# --- flags --------------------------------------------------------------------------------------


@pytest.fixture(params=["eventfd", "pipe"])
def flag(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Flag]:
    if request.param == "pipe":
        monkeypatch.delattr(os, "eventfd")
    made = Flag()
    yield made
    made.close()


def is_set(flag: Flag) -> bool:
    return bool(select.select([flag.descriptor], [], [], 0)[0])


def test_a_flag_is_readable_from_set_to_clear(flag: Flag) -> None:
    assert not is_set(flag)
    flag.clear()
    flag.set()
    assert is_set(flag)
    flag.set()
    flag.clear()
    assert not is_set(flag)


def test_a_flag_may_be_set_more_often_than_a_pipe_has_room(flag: Flag) -> None:
    for _ in range(70_000):
        flag.set()
    flag.clear()
    assert not is_set(flag)


def test_a_closed_flag_does_nothing_and_leaves_no_descriptor(flag: Flag) -> None:
    before = set(os.listdir("/proc/self/fd"))
    other = Flag()
    other.set()
    for _ in range(2):
        other.close()
        other.set()
        other.clear()
    assert other.descriptor == -1
    assert set(os.listdir("/proc/self/fd")) == before


def test_programs_that_are_started_do_not_inherit_a_flag(flag: Flag) -> None:
    assert not os.get_inheritable(flag.descriptor)


# --- pollers ------------------------------------------------------------------------------------


class Ends:
    """Connected sockets: what is written to `far` is read at `near`."""

    def __init__(self, stack: ExitStack, count: int) -> None:
        pairs = [socket.socketpair() for _ in range(count)]
        self.near = [stack.enter_context(pair[0]) for pair in pairs]
        self.far = [stack.enter_context(pair[1]) for pair in pairs]


@pytest.fixture(params=["epoll", "selector"])
def poller(request: pytest.FixtureRequest) -> Iterator[DescriptorPoller]:
    made = make_poller() if request.param == "epoll" else SelectorPoller()
    yield made
    made.close()
    assert made.closed


@pytest.fixture
def ends() -> Iterator[Ends]:
    with ExitStack() as stack:
        yield Ends(stack, 10)


def test_a_poller_reports_the_events_that_are_wanted(poller: DescriptorPoller, ends: Ends) -> None:
    first, second = (end.fileno() for end in ends.near[:2])
    poller.register(first, select.POLLIN)
    poller.register(second, select.POLLIN | select.POLLOUT)
    assert poller.poll(0, 10) == [(second, select.POLLOUT)]
    ends.far[0].send(b"1")
    ends.far[1].send(b"1")
    found = dict(poller.poll(0, 10))
    assert found == {first: select.POLLIN, second: select.POLLIN | select.POLLOUT}
    # A connection that is not read and has nothing to send is kept without events.
    poller.modify(first, 0)
    poller.modify(second, select.POLLIN)
    assert dict(poller.poll(0, 10)) == {second: select.POLLIN}
    poller.modify(first, select.POLLIN)
    poller.unregister(second)
    assert dict(poller.poll(0, 10)) == {first: select.POLLIN}
    poller.modify(first, 0)
    poller.unregister(first)
    assert poller.poll(0, 10) == []


def test_a_poller_is_readable_while_one_of_its_descriptors_is(
    poller: DescriptorPoller, ends: Ends
) -> None:
    poller.register(ends.near[0].fileno(), select.POLLIN)
    assert not select.select([poller.fileno()], [], [], 0)[0]
    ends.far[0].send(b"1")
    assert select.select([poller.fileno()], [], [], 0)[0]
    ends.near[0].recv(1)
    assert not select.select([poller.fileno()], [], [], 0)[0]


def test_all_come_when_a_poller_returns_some_at_a_time(
    poller: DescriptorPoller, ends: Ends
) -> None:
    for near, far in zip(ends.near, ends.far, strict=True):
        poller.register(near.fileno(), select.POLLIN)
        far.send(b"1")
    left = {near.fileno() for near in ends.near}
    while left:
        found = poller.poll(0, 3)
        assert len(found) == 3
        left -= {descriptor for descriptor, _ in found}


def test_a_descriptor_is_registered_once(poller: DescriptorPoller, ends: Ends) -> None:
    poller.register(ends.near[0].fileno(), select.POLLIN)
    with pytest.raises(FileExistsError):
        poller.register(ends.near[0].fileno(), select.POLLIN)


# --- others ---------------------------------------------------------------------------------------


def test_without_limits_of_the_system_the_usual_number_of_descriptors_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    assert most_descriptors() == 1024


def test_a_file_is_locked_where_there_are_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open(tmp_path / "file", "w") as first, open(tmp_path / "file", "w") as second:
        fcntl.flock(first, fcntl.LOCK_EX)
        with pytest.raises(BlockingIOError):
            lock_file(second.fileno())
        monkeypatch.setitem(sys.modules, "fcntl", None)
        lock_file(second.fileno())
