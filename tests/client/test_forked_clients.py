"""
A process with clients that forks: its child neither disturbs nor keeps its connections.

Each test is a program of its own, so that no thread of pytest is forked.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

# Each forks a program of its own.
pytestmark = pytest.mark.slow

HEAD = """
import asyncio, gc, os, signal, socket, sys
from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusConnectionError
from tests.support.peers import answer, dead, peer_at

signal.alarm(50)


def in_child(act):
    # Fork, do it in the child, and return its exit status.
    child = os.fork()
    if not child:
        signal.alarm(30)
        try:
            act()
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


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


def reply(request, write):
    write(answer(request, SCHEME))
"""


def run(program: str, scheme: str = "tcp") -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-W",
            "ignore::DeprecationWarning",
            "-c",
            f"SCHEME = {scheme!r}\n{HEAD}{program}",
        ],
        capture_output=True,
        text=True,
        timeout=55,
        check=False,
    )
    assert (done.stdout, done.stderr, done.returncode) == ("good\n", "", 0)


@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu+tcp", "rtu"])
def test_a_parent_hears_on_whatever_its_child_does_with_the_client(scheme: str) -> None:
    run(
        """
def forget():
    global plc
    del plc
    gc.collect()


def close():
    asyncio.run(plc.close())


def abandon():
    plc.abandon()
    plc.abandon()


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


for act in [forget, close, abandon, use, use_and_close]:
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
    with dead() as port:
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
def test_a_child_is_told_of_states_when_it_uses_the_client_not_while_it_is_forked(
    kind: str,
) -> None:
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
