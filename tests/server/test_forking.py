"""
A process that serves and forks: what its child has, and what its clients see.

Each test is a program of its own, so that no thread of pytest is forked.
"""

import subprocess
import sys

import pytest

HEAD = """
import os, signal, socket, struct, sys, termios, threading, time
from libmodbus_py import Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.tools.testing.wires import SerialWire

PATIENCE = 20
READ = struct.pack(">HHHB", 7, 0, 6, 1) + b"\\3\\0\\0\\0\\1"


def place(running, at=0):
    return "127.0.0.1", int(running.urls[at].rpartition(":")[2])


def connect(running, at=0):
    return socket.create_connection(place(running, at), timeout=PATIENCE)


def ask(client):
    client.sendall(READ)
    answer = client.recv(100)
    assert answer[:7] == READ[:4] + b"\\0\\5\\1" and answer[7:9] == b"\\3\\2", answer


def ended(client):
    return client.recv(100) == b""


def forked(run=signal.pause):
    # A child that lives until it is told to end, as it does with its parent; its reads
    # and writes of the pipes are what both wait for.
    ready, told = os.pipe()
    child = os.fork()
    if not child:
        try:
            signal.alarm(50)
            os.write(told, b"x")
            run()
        finally:
            os._exit(0)
    os.close(told)
    assert os.read(ready, 1) == b"x"
    os.close(ready)
    return child


def end(child):
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


device = Device(Mapping(holding_registers=4))
signal.alarm(50)
"""


def run(script: str) -> None:
    process = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", HEAD + script],
        capture_output=True,
        text=True,
        timeout=55,
        check=False,
    )
    assert (process.stdout, process.returncode) == ("good\n", 0)
    assert "Traceback" not in process.stderr


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_clients_see_the_end_of_their_connection(scheme: str) -> None:
    """Of one that the server closes, and of all when it ends; the child lives on."""
    run(f"""
server = Server(device)
with server.background("{scheme}://127.0.0.1:0", "tcp://127.0.0.1:0") as running:
    clients = [connect(running, 0), connect(running, 1), connect(running, 1)]
    ask(clients[1])
    ask(clients[2])
    child = forked()
    ask(clients[1])
    late = connect(running, 1)  # after the fork
    ask(late)
    clients[1].sendall(b"\\0\\0\\0\\0\\xff\\xff\\1\\3")
    assert ended(clients[1])
    ask(clients[2])
assert ended(clients[0]) and ended(clients[2]) and ended(late)
for at in (0, 1):
    try:
        connect(running, at)
        raise AssertionError("somebody listens")
    except ConnectionRefusedError:
        pass
end(child)
print("good")
""")


def test_a_udp_port_is_free_when_the_server_ended() -> None:
    run("""
with Server(device).background("udp://127.0.0.1:0") as running:
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.settimeout(PATIENCE)
    client.connect(place(running))
    ask(client)
    child = forked()
    ask(client)
again = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
again.bind(place(running))
end(child)
print("good")
""")


def test_a_serial_port_keeps_its_settings_in_a_child_and_is_free_when_the_server_ends() -> None:
    run("""
def settings():
    port = os.open(wire.server, os.O_RDWR | os.O_NOCTTY)
    try:
        return termios.tcgetattr(port)
    finally:
        os.close(port)


def is_taken():
    port = SerialPort(wire.server)
    try:
        port.open()
    except ModbusConnectionError as error:
        assert "in use" in str(error), error
        return True
    port.close()
    return False


with SerialWire() as wire:
    with Server(device).background(f"rtu://{wire.server}"):
        before = settings()
        child = forked()
        assert settings() == before
        assert is_taken()
        from libmodbus_py import Client
        with Client(wire.client, timeout=PATIENCE) as plc:
            assert plc.read_holding_registers(0, 1) == [0]
    assert not is_taken()
    end(child)
print("good")
""")


@pytest.mark.parametrize("ending", ["os._exit(0)", "signal.pause()"])
def test_a_hook_may_fork(ending: str) -> None:
    run(f"""
from libmodbus_py.device import hooks
hooks.SLOW = PATIENCE  # a fork takes its time on a busy machine, which would be logged
children = []

def fork(access):
    children.append(forked(lambda: {ending}))

hooked = Device(Mapping(holding_registers=4), before_read=fork)
with Server({{1: hooked, 2: device}}).background("tcp://127.0.0.1:0") as running:
    clients = [connect(running) for _ in range(3)]
    for client in clients:
        ask(client)
    clients[0].sendall(b"\\0\\0\\0\\0\\xff\\xff\\1\\3")
    assert ended(clients[0])
assert ended(clients[1]) and ended(clients[2])
for child in children:
    end(child)
print("good")
""")


def test_a_child_may_end_the_block_and_start_its_own_server() -> None:
    """It closes what it no longer has, and neither complains nor disturbs its parent."""
    run("""
with SerialWire() as wire:
    with Server(device).background(
        "tcp://127.0.0.1:0", "udp://127.0.0.1:0", f"rtu://{wire.server}"
    ) as running:
        client = connect(running)
        ask(client)
        child = os.fork()
        if not child:
            signal.alarm(50)
    if not child:
        status = 1
        try:
            device.mapping.holding_registers[0] = 9
            with Server(device).background("tcp://127.0.0.1:0") as running:
                ask(connect(running))
            status = 0
        finally:
            os._exit(status)
    assert ended(client)
    assert os.waitpid(child, 0)[1] == 0
with Server(device).background("tcp://127.0.0.1:0") as running:
    ask(connect(running))
assert device.mapping.holding_registers[0] == 0
print("good")
""")
