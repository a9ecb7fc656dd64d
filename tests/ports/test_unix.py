"""Unix sockets: who may listen and connect, what becomes of the file, and how clients are named."""

import asyncio
import contextlib
import errno
import fcntl
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Gateway,
    Limits,
    Mapping,
    ModbusConnectionError,
    Route,
    Server,
)
from libmodbus_py.ports import unix
from libmodbus_py.ports.hosts import host_of_peer
from libmodbus_py.ports.unix import MAX_PATH, UnixListener, UnixPort
from tests.support.cases import each_case


@pytest.fixture
def path(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A path that is short enough for a socket."""
    return str(tmp_path_factory.mktemp("u") / "m.sock")


def server(**options: Any) -> Server:
    return Server(Device(Mapping(holding_registers={0: [1, 2, 3]})), **options)


def stale(path: str) -> None:
    """Leave the file of a server that died."""
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(path)


def test_a_blocking_client_reads_and_writes(path: str) -> None:
    with server().background(f"unix://{path}") as running, Client(f"unix://{path}") as client:
        assert running.urls == [f"unix://{path}"]
        client.write_register(1, 7)
        assert client.read_holding_registers(0, 3) == [1, 7, 3]


async def test_an_asyncio_client_reads_from_a_server_in_its_loop(path: str) -> None:
    async with (
        server().serving(f"unix://{path}", "tcp://127.0.0.1:0"),
        AsyncClient(f"unix://{path}") as client,
    ):
        reads = (client.read_holding_registers(at, 1) for at in (0, 1, 2) * 20)
        assert await asyncio.gather(*reads) == [[1], [2], [3]] * 20


def test_a_gateway_listens_and_asks_over_paths(path: str) -> None:
    front = f"{path}.front"
    with (
        server().background(f"unix://{path}"),
        Gateway([Route(f"unix://{path}", "1-3")]).background(f"unix://{front}"),
        Client(f"unix://{front}", unit=2) as client,
    ):
        client.write_register(0, 9)
        assert client.read_holding_registers(0, 3) == [9, 2, 3]


def test_a_gateway_refuses_a_line_to_itself(path: str) -> None:
    os.symlink(path, f"{path}.link")
    with (
        pytest.raises(ValueError, match="the gateway itself listens"),
        Gateway([Route(f"unix://{path}.link")]).background(f"unix://{path}"),
    ):
        pass


def test_the_owner_and_the_group_may_connect_whatever_the_umask_is(path: str) -> None:
    before = os.umask(0o077)
    try:
        with server().background(f"unix://{path}"):
            assert stat.S_IMODE(os.stat(path).st_mode) == 0o660
    finally:
        os.umask(before)


@pytest.fixture
def open_folder() -> Iterator[str]:
    """A folder in which every user may make files."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o777)
        yield folder


def by_another_user(call: Callable[[], object]) -> int:
    """Call in a child, which is not root, whom the system lets in everywhere; return its status."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            if os.geteuid() == 0:
                os.setgroups([])
                os.setgid(65534)
                os.setuid(65534)
            call()
            status = 0
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_a_server_killed_while_it_begins_does_not_lock_its_user_out(open_folder: str) -> None:
    path = f"{open_folder}/m.sock"

    def begin(and_then: Callable[..., object]) -> None:
        os.chmod = and_then
        asyncio.run(UnixListener(path).open())

    killed = by_another_user(lambda: begin(lambda *_: os.kill(os.getpid(), signal.SIGKILL)))
    assert killed == -signal.SIGKILL
    assert os.path.exists(path)
    assert by_another_user(lambda: begin(lambda *_: None)) == 0


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become another user")
def test_users_but_owner_and_group_may_not_connect(open_folder: str) -> None:
    url = f"unix://{open_folder}/m.sock"

    def connect() -> None:
        with pytest.raises(ModbusConnectionError, match="Permission denied") as caught:
            Client(url).connect()
        assert caught.value.errno == errno.EACCES

    with server().background(url):
        assert by_another_user(connect) == 0


def test_a_server_ends_although_its_folder_was_removed(path: str) -> None:
    with server().background(f"unix://{path}"):
        shutil.rmtree(os.path.dirname(path))
    assert not os.path.exists(path)


def test_a_client_stays_with_its_server_when_another_one_gets_the_path(path: str) -> None:
    with server().background(f"unix://{path}"), Client(f"unix://{path}") as first:
        os.unlink(path)
        with server().background(f"unix://{path}"), Client(f"unix://{path}") as second:
            second.write_register(0, 9)
            assert first.read_holding_registers(0, 1) == [1]
            assert second.read_holding_registers(0, 1) == [9]
        assert first.read_holding_registers(0, 1) == [1]


def test_the_socket_file_is_removed_with_the_server(path: str) -> None:
    for _ in range(2):
        with server().background(f"unix://{path}"):
            assert os.path.exists(path)
        assert os.listdir(os.path.dirname(path)) == []


def test_a_file_of_another_program_stays(path: str) -> None:
    listener = UnixListener(path)
    with asyncio.run(listener.open()):
        os.unlink(path)
        with socket.socket(socket.AF_UNIX) as other:
            other.bind(path)
            listener.close()
            assert os.path.exists(path)


def refused(path: str, number: int, text: str) -> None:
    running = server().background(f"unix://{path}")
    with pytest.raises(ModbusConnectionError, match=text) as caught, running:
        pass
    assert caught.value.errno == number
    assert f"cannot listen on unix://{path}" in str(caught.value)


def test_a_path_in_use_is_refused_however_it_is_written(path: str) -> None:
    folder, name = os.path.split(path)
    os.symlink(folder, f"{folder}/link")
    with server().background(f"unix://{path}"):
        for other in (path, f"/{path}", f"{folder}/./{name}", f"{folder}/link/{name}"):
            refused(other, errno.EADDRINUSE, "in use")
            with Client(f"unix://{other}") as client:
                assert client.read_holding_registers(0, 1) == [1]


async def test_of_listeners_in_one_loop_one_gets_a_path(path: str) -> None:
    stale(path)
    listeners = [UnixListener(path) for _ in range(3)]
    opening = (listener.open() for listener in listeners)
    listener, *others = await asyncio.gather(*opening, return_exceptions=True)
    assert [getattr(other, "errno", 0) for other in others] == [errno.EADDRINUSE] * 2
    assert isinstance(listener, socket.socket)
    for peer in (*listeners[1:], listener):
        peer.close()
    assert os.path.exists(path)
    listeners[0].close()
    assert not os.path.exists(path)


def test_a_path_of_a_server_that_is_busy_is_in_use(path: str) -> None:
    """Its backlog is full, so that it accepts nobody."""
    with socket.socket(socket.AF_UNIX) as sock, socket.socket(socket.AF_UNIX) as client:
        sock.bind(path)
        sock.listen(0)
        client.connect(path)
        refused(path, errno.EADDRINUSE, "in use")
        with pytest.raises(ModbusConnectionError, match="unavailable"):
            Client(f"unix://{path}").connect()


def test_a_socket_for_datagrams_is_in_use(path: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(path)
        refused(path, errno.EADDRINUSE, "in use")
    assert os.path.exists(path)


@each_case("kind", ["file", "folder", "link", "dangling"])
def test_a_file_that_is_no_socket_is_refused_and_stays(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / kind
    folder.mkdir()
    path = folder / "x"
    if kind == "file":
        path.write_text("precious")
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(folder / "o")
        if kind == "link":
            stale(str(folder / "o"))
    refused(str(path), errno.EEXIST, "no socket")
    assert os.path.lexists(path)


def test_a_folder_that_is_missing_is_an_error(path: str) -> None:
    refused(f"{path}/none/x", errno.ENOENT, "No such file")


def test_a_folder_that_is_read_only_is_an_error(open_folder: str) -> None:
    os.chmod(open_folder, 0o500)
    path = f"{open_folder}/m.sock"
    assert by_another_user(lambda: refused(path, errno.EACCES, "denied")) == 0


def test_the_longest_path_can_be_used_and_no_longer_one(path: str) -> None:
    longest = os.path.dirname(path) + "/"
    longest += "x" * (MAX_PATH - len(longest))
    with server().background(f"unix://{longest}"), Client(f"unix://{longest}") as client:
        assert client.read_holding_registers(0, 1) == [1]
    for make in (UnixPort, UnixListener):
        with pytest.raises(ValueError, match=r"path must have 1\.\.10"):
            make(f"{longest}x")
        with pytest.raises(ValueError, match="path must have"):
            make("/run/\0")
        with pytest.raises(ValueError, match="path must have"):
            make("/" + "ä" * (MAX_PATH // 2 + 1))
    with pytest.raises(ValueError, match="path must have"):
        Client(f"unix://{longest}x")


def test_unusual_names_work(path: str) -> None:
    url = f"unix://{path}%23%20%3F%C3%A4%25"
    with server().background(url) as running, Client(running.urls[0]) as client:
        assert running.urls == [url]
        assert os.path.exists(f"{path}# ?ä%")
        assert client.read_holding_registers(0, 1) == [1]


def test_a_forked_child_neither_removes_the_file_nor_keeps_the_port(path: str) -> None:
    with server().background(f"unix://{path}"):
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)
        assert os.path.exists(path)
        with Client(f"unix://{path}") as client:
            assert client.read_holding_registers(0, 1) == [1]


# Listens at each line, and lets go at the next, as a program that dies: the file stays.
LISTENING = """
import asyncio, sys
from libmodbus_py.ports.unix import UnixListener

while sys.stdin.readline():
    made = None
    try:
        made = asyncio.run(UnixListener(sys.argv[1]).open())
        print(0, flush=True)
    except OSError as error:
        print(error.errno, flush=True)
    sys.stdin.readline()
    if made:
        made.close()
    print(flush=True)
"""


def test_of_two_processes_that_find_a_dead_socket_one_listens(path: str) -> None:
    stale(path)
    with contextlib.ExitStack() as stack:
        pipe = subprocess.PIPE
        command = [sys.executable, "-c", LISTENING, path]
        others = [
            stack.enter_context(subprocess.Popen(command, stdin=pipe, stdout=pipe, bufsize=0))
            for _ in range(2)
        ]

        def all_do() -> list[bytes]:
            for other in others:
                assert other.stdin is not None
                other.stdin.write(b"\n")
            return sorted(other.stdout.readline() for other in others if other.stdout is not None)

        for _ in range(50):
            assert all_do() == [b"0\n", b"%d\n" % errno.EADDRINUSE]
            all_do()


@contextlib.contextmanager
def locked(folder: str) -> Iterator[None]:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def test_a_folder_that_stays_locked_is_an_error(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unix, "TRIES", 1)
    with locked(os.path.dirname(path)):
        refused(path, errno.EBUSY, "locked by another program")


async def test_a_locked_folder_delays_only_its_own_server(path: str) -> None:
    with locked(os.path.dirname(path)):
        starting = asyncio.ensure_future(UnixListener(path).open())
        for _ in range(3):
            await asyncio.sleep(0)
        assert not starting.done()
    (await starting).close()


def test_no_server_is_a_connection_error(path: str) -> None:
    with pytest.raises(ModbusConnectionError, match=f"cannot connect to {path}: No such") as caught:
        Client(f"unix://{path}").connect()
    assert caught.value.errno == errno.ENOENT
    stale(path)
    with pytest.raises(ModbusConnectionError, match="refused"):
        Client(f"unix://{path}").connect()


@each_case("kind", ["file", "folder", "datagrams"])
def test_a_peer_that_is_no_server_is_a_connection_error_of_both_clients(kind: str) -> None:
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        path = f"{folder}/m.sock"
        if kind == "file":
            Path(path).touch()
        elif kind == "folder":
            os.mkdir(path)
        else:
            stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)).bind(path)

        async def connect() -> None:
            async with AsyncClient(f"unix://{path}"):
                pass

        for attempt in (Client(f"unix://{path}").connect, lambda: asyncio.run(connect())):
            with pytest.raises(ModbusConnectionError, match=f"cannot connect to {path}") as caught:
                attempt()
            assert caught.value.errno in (errno.ECONNREFUSED, errno.EPROTOTYPE)


def test_a_client_is_named_by_the_path_its_user_and_its_process(path: str) -> None:
    events: list[Any] = []
    frames: list[Any] = []
    server_ = server(audit=events.append, trace=frames.append)
    with server_.background(f"unix://{path}"), Client(f"unix://{path}") as client:
        client.write_register(0, 5)
    name = f"{path} uid {os.getuid()} pid {os.getpid()}"
    assert {event.peer for event in events} == {"", name}
    assert {frame.peer for frame in frames} == {name}
    assert host_of_peer(name) == f"{path} uid {os.getuid()}"


def test_networks_do_not_concern_paths_but_the_limits_of_one_address_do(path: str) -> None:
    limits = Limits(allow=["192.0.2.0/24"], connections_per_address=1, when_full="refuse")
    server_ = server(limits=limits)
    with server_.background(f"unix://{path}"), Client(f"unix://{path}") as client:
        assert client.read_holding_registers(0, 1) == [1]
        with Client(f"unix://{path}") as other, pytest.raises(ModbusConnectionError):
            other.read_holding_registers(0, 1)
        assert server_.statistics.refused_address >= 1


def test_the_path_is_the_name_of_a_client_that_closed_its_socket(path: str) -> None:
    one, other = socket.socketpair(socket.AF_UNIX)
    one.close()
    other.close()
    assert UnixListener(path).name(one) == (path, path)
