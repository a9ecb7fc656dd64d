"""Programs with clients: that fork, that have no descriptor left, that end or are killed."""

import subprocess
import sys

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from tests.support.clients import ALL
from tests.support.peers import LinePeer, peer_at
from tests.support.reads import on_read_at

# Each program is a process of its own, so that no thread of pytest is forked.
pytestmark = pytest.mark.slow

HEAD = """
import asyncio, gc, os, signal, socket, sys
from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusConnectionError
from tests.support.peers import mute_port, peer_at
from tests.support.reads import on_read_at
from tests.support.signals import in_child

signal.alarm(50)


def sockets():
    found = set()
    for name in os.listdir("/proc/self/fd"):
        try:
            found.add(os.readlink(f"/proc/self/fd/{name}"))
        except OSError:
            pass
    return found


def is_open(descriptor):
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


reply = on_read_at(SCHEME)
"""


def ended(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python to its end; return the output."""
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=55, check=False)


def run(program: str, scheme: str = "tcp") -> None:
    whole = f"SCHEME = {scheme!r}\n{HEAD}{program}"
    process = ended("-W", "ignore::DeprecationWarning", "-c", whole)
    assert (process.stdout, process.stderr, process.returncode) == ("good\n", "", 0)


@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu+tcp", "rtu"])
def test_a_child_does_not_disturb_the_client_of_its_parent(scheme: str) -> None:
    run(
        """
def forget():
    global plc
    del plc
    gc.collect()


def close():
    asyncio.run(plc.close())


def use():
    assert asyncio.run(plc.read_holding_registers(9, 1)) == [9]


async def used_and_closed():
    async with plc:
        assert await plc.read_holding_registers(8, 1) == [8]


def use_and_close():
    asyncio.run(used_and_closed())


async def main(act):
    global plc
    with peer_at(SCHEME, reply) as peer:
        plc = AsyncClient(peer.url, timeout=20)
        assert await plc.read_holding_registers(1, 1) == [1]
        assert in_child(act) == 0
        for address in range(5):
            assert await plc.read_holding_registers(address, 1) == [address]
        assert plc.statistics.connects == 1
        await plc.close()


for act in [forget, close, use, use_and_close]:
    if SCHEME != "rtu" or act not in (use, use_and_close):  # the line is locked by the parent
        asyncio.run(main(act))
print("good")
""",
        scheme,
    )


@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu"])
@pytest.mark.parametrize("kind", ["AsyncClient", "Client"])
def test_a_child_keeps_no_descriptor_of_a_client(kind: str, scheme: str) -> None:
    run(
        f"""
async def main():
    with peer_at(SCHEME, reply) as peer:
        plc = {kind}(peer.url, timeout=20)
        asked = plc.read_holding_registers(1, 1)
        assert (await asked if asyncio.iscoroutine(asked) else asked) == [1]
        port = plc._driver._port
        opened = [port.descriptor, *getattr(port, "_guards", [])]

        def look():
            assert [each for each in opened if is_open(each)] == []

        assert all(map(is_open, opened))
        assert in_child(look) == 0
        closed = plc.close()
        if asyncio.iscoroutine(closed):
            await closed
    print("good")


asyncio.run(main())
""",
        scheme,
    )


def test_a_child_keeps_no_connection_that_was_being_made() -> None:
    run("""
async def main():
    with mute_port() as port:
        before = sockets()
        plc = AsyncClient(f"tcp://127.0.0.1:{port}", timeout=20)
        connecting = asyncio.create_task(plc.connect())
        while not (opened := {each for each in sockets() - before if "socket:" in each}):
            await asyncio.sleep(0)

        def look():
            assert not opened & sockets()

        assert in_child(look) == 0
        connecting.cancel()
        await asyncio.wait([connecting])
        await plc.close()
    print("good")


asyncio.run(main())
""")


@pytest.mark.parametrize("kind", ["AsyncClient", "Client"])
def test_a_child_gets_no_states_from_the_fork_itself(kind) -> None:
    run(f"""
def ask(plc):
    asked = plc.read_holding_registers(1, 1)
    assert (asyncio.run(once(asked)) if asyncio.iscoroutine(asked) else asked) == [1]


async def once(asked):
    return await asked


told = []

with peer_at(SCHEME, reply) as peer:
    plc = {kind}(peer.url, timeout=20, on_state=lambda state, error: told.append(state.name))
    ask(plc)
    assert told == ["CONNECTING", "CONNECTED"]
    told.clear()

    def use():
        assert told == []
        ask(plc)
        assert told == ["DISCONNECTED", "CONNECTING", "CONNECTED"], told

    assert in_child(use) == 0
    assert told == []
    if {kind!r} == "Client":
        plc.close()
    else:
        sys.stderr = open(os.devnull, "w")  # its loop is closed: it says that it was not closed
        del plc
        gc.collect()
print("good")
""")


# Every import opens a file, so a module that is first needed now cannot be had.
PROGRAM = """
import asyncio, errno, resource, sys
from libmodbus_py import ModbusConnectionError, ModbusError

url, kind = sys.argv[1:]
if kind == "asyncio":
    from libmodbus_py import AsyncClient
else:
    from libmodbus_py import Client
soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)

def fail(*_):
    raise ZeroDivisionError

HOOKS = [{}, {"on_state": fail}, {"trace": fail}]

def outcome(plc):
    try:
        return plc.read_holding_registers(5, 1)
    except ModbusError as error:
        return error

def told(found):
    for error in found:
        assert isinstance(error, ModbusConnectionError), repr(error)
        assert error.errno == errno.EMFILE, repr(error)
        str(error)

def blocking(options):
    plc = Client(url, max_pause=0.001, **options)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    told([outcome(plc) for _ in range(3)])
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert outcome(plc) == [5]
    plc.close()

async def asynchronous(options):
    plc = AsyncClient(url, max_pause=0.001, **options)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    reads = [plc.read_holding_registers(5, 1) for _ in range(3)]
    told(await asyncio.gather(*reads, return_exceptions=True))
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert await plc.read_holding_registers(5, 1) == [5]
    await plc.close()

for options in HOOKS:
    asyncio.run(asynchronous(options)) if kind == "asyncio" else blocking(options)
print("ok")
"""


@ALL
@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu"])
def test_a_lack_of_descriptors_is_an_error_until_they_are_free(scheme: str, kind: str) -> None:
    with peer_at(scheme, on_read_at(scheme)) as peer:
        process = ended("-c", PROGRAM, peer.url, kind)
    assert process.stdout == "ok\n", process.stderr


LEFT_OPEN = """
import asyncio, sys
from libmodbus_py import AsyncClient, Client
url, how = sys.argv[1:]
contexts = [Client(url) for _ in range(2)]
for context in contexts:
    context.read_coils(0, 1)
if how == "circle":
    contexts.append(contexts)
    context.me = contexts
async def main():
    global client, waiting
    client = AsyncClient(url)
    await client.read_coils(0, 1)
    if how == "waiting":
        waiting = asyncio.ensure_future(client.read_coils(1, 1))
        await asyncio.sleep(0)
asyncio.run(main())
"""


@pytest.mark.parametrize("how", ["globals", "circle", "waiting"])
@pytest.mark.parametrize("warn", [True, False])
def test_a_program_that_ends_with_open_clients_prints_nothing(warn: bool, how: str) -> None:
    options = ["-W", "default"] if warn else []
    with Server(Device(Mapping(coils=8))).background("tcp://127.0.0.1:0") as running:
        process = ended(*options, "-c", LEFT_OPEN, running.urls[0], how)
    assert process.returncode == 0
    lines = [line for line in process.stderr.splitlines() if "ResourceWarning" not in line]
    if not warn:
        assert lines == []
    assert "Exception ignored" not in process.stderr
    assert "Traceback" not in process.stderr


def test_a_port_with_the_settings_of_a_killed_program_is_opened() -> None:
    """The port has these settings already, and a pseudo-terminal refuses one of them."""
    with LinePeer(on_read_at("rtu")) as unit:
        program = (
            "import os, sys, libmodbus_py as m\n"
            "context = m.Client(sys.argv[1], baudrate=115200)\n"
            "context.connect()\n"
            "os.kill(os.getpid(), 9)"
        )
        for times in range(3):
            ended("-c", program, unit.path)
            if times:
                with Client(f"rtu://{unit.path}", baudrate=115200) as context:
                    assert context.read_holding_registers(times, 1) == [times]
