"""
Each attack against a gateway, with a device behind it: an innocent client loses nothing and
gets only right values, and nothing of the attack is left.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest

from libmodbus_py import (
    Context,
    Device,
    ExceptionResponse,
    Gateway,
    GatewayTargetFailedToRespond,
    Mapping,
    ModbusConnectionError,
    Route,
    Server,
)
from libmodbus_py.ports.endpoint import parse
from tests.support.attacks import (
    ATTACKS,
    Attack,
    AttackerProcess,
    Innocent,
    ServerProcess,
    descriptor_limit,
)
from tests.support.gateways import passage
from tests.support.peers import FakeServer, until

MEMORY = 32 << 20


class GatewayProcess(ServerProcess):
    """``libmodbus-py gateway`` before a server."""

    def __init__(self, server: ServerProcess) -> None:
        to = f"tcp://127.0.0.1:{server.port}?timeout=5"
        command = [sys.executable, "-m", "libmodbus_py", "gateway", "tcp://127.0.0.1:0", "--to", to]
        self._urls = ["tcp://127.0.0.1:0"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.pid = self._process.pid


OVER_TCP = [attack for attack in ATTACKS if attack.scheme == "tcp"]


@pytest.mark.parametrize("attack", OVER_TCP, ids=lambda attack: attack.name.replace(" ", "-"))
def test_an_innocent_client_loses_nothing(attack: Attack) -> None:
    with (
        descriptor_limit(),
        ServerProcess() as server,
        GatewayProcess(server) as gateway,
        Innocent(gateway.port) as innocent,
        AttackerProcess(attack, gateway.port) as attackers,
    ):
        innocent.poll(0.3)
        descriptors, resident = gateway.descriptors(), gateway.resident()
        attackers.begin()
        attacked = innocent.poll(1, until=attackers.all_attack)
        grown = gateway.resident() - resident
        attackers.end()
        assert attacked.requests > 0
        assert (attacked.lost, attacked.wrong) == (0, 0)
        assert grown < MEMORY
        assert gateway.has_descriptors(descriptors)
        recovered = innocent.poll(0.1)
        assert (recovered.lost, recovered.wrong) == (0, 0)


def small() -> Device:
    return Device(Mapping(10, 10, 10, 10))


def test_a_device_that_says_anything_has_nothing_of_it_passed_on() -> None:
    """What is no answer is 0B; what comes unasked, or for somebody else, is nothing."""
    answers = [
        lambda request: [request[:2] + b"\0\0\0\5\1\3\2\0\7"],  # good
        lambda request: [b"\xff\xff\0\0\0\5\1\3\2\0\1"],  # another transaction
        lambda request: [request[:2] + b"\0\0\0\5\2\3\2\0\1"],  # another unit
        lambda request: [request[:2] + b"\0\0\0\5\1\4\2\0\1"],  # another function
        lambda request: [request[:2] + b"\0\0\0\7\1\3\4\0\1\0\1"],  # too much
        lambda request: [request[:2] + b"\0\1\0\5\1\3\2\0\1"],  # another protocol
        lambda request: [b"\xff" * 300],
    ]
    for bad in answers[1:]:
        with (
            FakeServer(answers[0], bad, answers[0]) as device,
            Gateway([Route(f"{device.url}?timeout=0.3&max_pause=0.1")]).background(
                "tcp://127.0.0.1:0"
            ) as running,
            Context.from_url(running.urls[0], unit=1, timeout=5) as context,
        ):
            assert context.read_holding_registers(0, 1) == [7]
            with pytest.raises(GatewayTargetFailedToRespond):
                context.read_holding_registers(0, 1)

            def answers_again(context: Context = context) -> bool:
                try:
                    return context.read_holding_registers(0, 1) == [7]
                except GatewayTargetFailedToRespond:
                    time.sleep(0.02)
                    return False

            until(answers_again)


def test_bytes_on_a_line_that_are_no_frame_cost_that_request_only() -> None:
    with (
        passage("rtu+tcp", "rtu", {1: small()}) as through,
        socket.create_connection(("127.0.0.1", parse(through.url).port)) as client,
    ):
        client.sendall(os.urandom(2000))
        with through.context(1) as context:
            for _ in range(20):
                assert context.read_holding_registers(0, 1) == [0]
        until(lambda: through.gateway.statistics.bad_frames > 0)


def test_a_hook_that_raises_is_an_exception_and_one_that_ends_ends_it() -> None:
    raised: list[BaseException] = [RuntimeError("no"), KeyError("x"), SystemExit(3)]

    def authorize(asked: object) -> bool:
        raise raised.pop(0)

    def use(device: str) -> None:
        gateway = Gateway([Route(device)], authorize=authorize)
        with (
            gateway.background("tcp://127.0.0.1:0") as running,
            Context.from_url(running.urls[0], unit=1, timeout=2) as context,
        ):
            for _ in range(2):
                with pytest.raises(ExceptionResponse) as seen:
                    context.read_holding_registers(0, 1)
                assert seen.value.code == 4
            with pytest.raises(ModbusConnectionError):
                context.read_holding_registers(0, 1)

    with Server({1: small()}).background("tcp://127.0.0.1:0") as behind, pytest.raises(SystemExit):
        use(behind.urls[0])


def where(descriptor: str) -> str:
    """What it leads to; nothing once it is closed."""
    try:
        return os.readlink(descriptor)
    except FileNotFoundError:
        return ""


@pytest.mark.parametrize("back", ["tcp", "udp", "rtu"])
def test_a_forked_child_has_nothing_of_its_lines(back: str) -> None:
    """Else a device would not see the gateway go."""
    with passage("tcp", back, {1: small()}) as through, through.context(1) as context:
        assert context.read_holding_registers(0, 1) == [0]
        answering = through.gateway._answering_now
        assert answering is not None
        descriptor = answering.lines[0]._client._driver._port.descriptor
        mine = os.readlink(f"/proc/self/fd/{descriptor}")
        child = os.fork()
        if not child:
            signal.pause()
            os._exit(0)
        try:
            assert context.read_holding_registers(0, 1) == [0]
            theirs = f"/proc/{child}/fd/{descriptor}"
            until(lambda: where(theirs) != mine)
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def test_floods_from_many_connections_leave_a_line_to_everybody() -> None:
    """A hundred requests at a time on eight connections, and one client that asks in turn."""
    with passage("tcp", "rtu", {1: small()}) as through, through.context(1, timeout=20) as context:
        request = b"\0\1\0\0\0\6\1\3\0\0\0\1"
        stop = threading.Event()

        def flood() -> None:
            address = ("127.0.0.1", parse(through.url).port)
            with socket.create_connection(address, 5, ("127.0.0.2", 0)) as connection:
                connection.setblocking(False)
                while not stop.is_set():
                    for act in (
                        lambda: connection.send(request * 100),
                        lambda: connection.recv(9999),
                    ):
                        try:
                            act()
                        except BlockingIOError:
                            time.sleep(0.001)
                        except OSError:
                            return

        threads = [threading.Thread(target=flood) for _ in range(8)]
        for thread in threads:
            thread.start()
        try:
            (line,) = through.gateway.passed.lines.values()
            until(lambda: line.full > 0)
            for _ in range(10):
                assert context.read_holding_registers(0, 1) == [0]
            assert line.waiting <= 8 * 16 + 16
        finally:
            stop.set()
            for thread in threads:
                thread.join()
