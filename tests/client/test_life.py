"""
Clients over their life, each kind of them: time, connections that come and go, the end.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
    ServerDeviceBusy,
    State,
    pdu,
)
from libmodbus_py.testing.wires import SerialWire
from tests.support.clients import Connect
from tests.support.fake import FakeServer, FakeUnit, dead, echo, refusing, until, url_of
from tests.support.pace import LATE
from tests.support.peers import answering

REQUEST = pdu.ReadHoldingRegisters(5, 1)


def good(request: bytes) -> list[bytes]:
    """Answer with the address, in as many frames as came together."""
    return [echo(request[at : at + 12]) for at in range(0, len(request), 12)]


def silent(request: bytes) -> list[bytes]:
    return []


# --- arguments -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"unit": 256}, "unit"),
        ({"unit": -1}, "unit"),
        ({"timeout": 0}, "timeout"),
        ({"timeout": "1"}, "timeout"),
        ({"timeout": float("nan")}, "timeout"),
        ({"retries": 101}, "retries"),
        ({"busy_retries": -1}, "busy_retries"),
        ({"max_in_flight": 0}, "max_in_flight"),
        ({"max_in_flight": 257}, "max_in_flight"),
        ({"turnaround": -1}, "turnaround"),
        ({"request_spacing": -1}, "request_spacing"),
        ({"connect_delay": "1"}, "connect_delay"),
        ({"timeouts_before_reconnect": 0}, "timeouts_before_reconnect"),
        ({"max_pause": -1}, "max_pause"),
        ({"keepalive": 0}, "keepalive"),
        ({"accept_unit": "all"}, "accept_unit"),
        ({"delimiter": 0x3A}, "delimiter"),
        ({"trace": 1}, "trace"),
        ({"on_state": 1}, "on_state"),
        ({"slave": 3}, "slave"),
    ],
)
def test_bad_option_is_named(connect: Connect, options: Any, named: str) -> None:
    with pytest.raises((ValueError, TypeError), match=named):
        connect("tcp://127.0.0.1", **options)


@pytest.mark.parametrize(
    ("url", "named"),
    [
        (None, "url"),
        ("http://x", "scheme"),
        ("tcp://", "host"),
        ("tcp://h:0", "port"),
        ("tcp://h:99999", "port"),
        ("rtu://", "device"),
        ("rtu:///dev/x?speed=9600", "speed"),
        ("rtu:///dev/x?baudrate=fast", "baudrate"),
        ("rtu:///dev/x?parity=X", "parity"),
        ("rtu:///dev/x?max_in_flight=16", "max_in_flight"),
        ("rtu+tcp://h?max_in_flight=2", "max_in_flight"),
        ("rtu+tcp://h?accept_unit=any", "accept_unit"),
    ],
)
def test_bad_url_is_named(connect: Connect, url: Any, named: str) -> None:
    with pytest.raises((ValueError, TypeError), match=named):
        connect(url)


@pytest.mark.parametrize(
    ("ask", "named"),
    [
        (lambda plc: plc.read_coils(-1, 1), "address must be in 0..65535"),
        (lambda plc: plc.read_coils(0, 2001), "count must be in 1..2000"),
        (lambda plc: plc.read_holding_registers(65535, 2), "must not pass 65536"),
        (lambda plc: plc.read_input_registers(0, 0), "count must be in 1..125"),
        (lambda plc: plc.write_register(0, 65536), "value must be in 0..65535"),
        (lambda plc: plc.write_registers(0, []), "values must hold 1..123"),
        (lambda plc: plc.write_registers(0, [0, -1]), r"values\[1\]"),
        (lambda plc: plc.write_coils(0, [True] * 1969), "values must hold 1..1968"),
        (lambda plc: plc.write_coil(0, "on"), "value"),
        (lambda plc: plc.read_file_records([(0, 0, 1)]), "file must be in 1..65535"),
        (lambda plc: plc.for_unit(256), "unit must be in 0..255"),
        (lambda plc: plc.for_unit(1, timeout=0), "timeout must be in"),
        (lambda plc: plc.execute(3), "request must be one of pdu, not int"),
        (lambda plc: plc.execute(REQUEST, retries=-1), "retries must be in 0..100"),
        (lambda plc: plc.read_values("coils", 0, "int16"), "table must be one of"),
        (lambda plc: plc.write_values("coils", 0, [1], "int16"), "table must be holding"),
    ],
)
def test_nothing_is_sent_for_bad_arguments(connect: Connect, ask: Any, named: str) -> None:
    with FakeServer(good) as server, connect(server.url) as plc:
        with pytest.raises((ValueError, TypeError), match=named):
            ask(plc)
        assert plc.read_holding_registers(5, 1) == [5]
        assert len(server.requests) == 1


# --- time --------------------------------------------------------------------------------


def test_timeouts_of_the_client_the_handle_and_the_request(connect: Connect) -> None:
    with FakeServer(good, silent) as server, connect(server.url, timeout=0.2) as plc:
        assert plc.execute(REQUEST) == [5]
        for ask, timeout in (
            (lambda: plc.execute(REQUEST), 0.2),
            (lambda: plc.for_unit(3, timeout=0.1).execute(REQUEST), 0.1),
            (lambda: plc.execute(REQUEST, timeout=0.05), 0.05),
        ):
            start = time.monotonic()
            with pytest.raises(ModbusTimeoutError, match=f"within {timeout} s"):
                ask()
            assert timeout <= time.monotonic() - start < timeout + LATE
        plc.timeout = 0.07
        assert plc.for_unit(3).timeout == 0.07
        with pytest.raises(ModbusTimeoutError, match=r"within 0.07 s"):
            plc.execute(REQUEST)


def test_three_timeouts_in_a_row_make_a_new_connection(connect: Connect) -> None:
    with FakeServer(silent) as server, connect(server.url, timeout=0.02) as plc:
        for _ in range(13):
            with pytest.raises(ModbusTimeoutError):
                plc.execute(REQUEST)
        assert server.connections == 5


def test_an_answer_between_timeouts_keeps_the_connection(connect: Connect) -> None:
    answers = [silent, silent, good] * 3
    with FakeServer(*answers) as server, connect(server.url, timeout=0.05) as plc:
        for answer in answers:
            with contextlib.nullcontext() if answer is good else pytest.raises(ModbusTimeoutError):
                assert plc.execute(REQUEST) == [5]
        assert server.connections == 1
        assert plc.statistics.timeouts == 6


def test_spacing_and_delay_are_kept(connect: Connect) -> None:
    came: list[float] = []

    def note(request: bytes) -> list[bytes]:
        came.append(time.monotonic())
        return good(request)

    options = {"request_spacing": 0.03, "connect_delay": 0.1, "timeout": 0.09}
    with FakeServer(note) as server, connect(server.url, **options) as plc:
        connected = time.monotonic()
        assert plc.execute_many([REQUEST] * 4) == [[5]] * 4
        assert plc.execute(REQUEST) == [5]
    assert came[0] - connected >= 0.09
    assert len(came) == 5
    assert sum(later - earlier for earlier, later in pairwise(came)) >= 4 * 0.03 - 0.005


def test_retries_are_sent_and_counted(connect: Connect) -> None:
    with (
        FakeServer(silent, None, good, silent) as server,
        connect(server.url, timeout=0.1, retries=2, max_pause=0) as plc,
    ):
        assert plc.execute(REQUEST) == [5]
        assert server.connections == 2
        assert plc.statistics.retries == 2
        with pytest.raises(ModbusTimeoutError):
            plc.execute(REQUEST, retries=0)
        with pytest.raises(ModbusTimeoutError):
            plc.diagnostics(0, 1)
        assert len(server.requests) == 5


def test_busy_devices_are_asked_again_if_the_caller_wants(connect: Connect) -> None:
    busy = iter([ServerDeviceBusy, ServerDeviceBusy])

    def refuse(access: object) -> None:
        if error := next(busy, None):
            raise error

    device = Device(Mapping(coils=8), before_read=refuse)
    with Server(device).background("tcp://127.0.0.1:0") as running:
        with connect(running.urls[0], busy_retries=2) as plc:
            start = time.monotonic()
            assert plc.read_coils(0, 1) == [False]
            assert time.monotonic() - start >= 0.3
        busy = iter([ServerDeviceBusy])
        with connect(running.urls[0]) as plc, pytest.raises(ServerDeviceBusy):
            plc.read_coils(0, 1)


# --- who is asked --------------------------------------------------------------------------


def test_handles_of_several_units_share_the_connection(connect: Connect) -> None:
    """Unit 0 over TCP is a unit like others."""
    with FakeServer(good) as server, connect(server.url, unit=0) as plc:
        handles = [plc, plc.for_unit(9), plc.for_unit(255)]
        assert [each.read_holding_registers(7, 1) for each in handles] == [[7]] * 3
        assert [request[6] for request in server.requests] == [0, 9, 255]
        assert server.connections == 1
        assert handles[1].statistics is plc.statistics
        handles[1].close()
        assert plc.closed


def test_a_request_that_nobody_answers_is_not_waited_for(connect: Connect) -> None:
    with FakeServer(silent, good) as server, connect(server.url, timeout=5, turnaround=0.02) as plc:
        start = time.monotonic()
        assert plc.diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY) == 0
        assert 0.02 <= time.monotonic() - start < LATE
        assert plc.read_holding_registers(5, 1) == [5]
        assert plc.statistics.timeouts == 0


def test_broadcast_waits_for_no_answer_and_reads_are_refused(connect: Connect) -> None:
    url = "rtu://{}?baudrate=115200&timeout=10&turnaround=0.05&unit=0"
    with FakeUnit(silent) as unit, connect(url.format(unit.path)) as everyone:
        start = time.monotonic()
        everyone.write_register(1, 2)
        everyone.write_coils(1, [True])
        assert 0.1 <= time.monotonic() - start < LATE
        with pytest.raises(ValueError, match="broadcast"):
            everyone.read_coils(0, 1)
    assert unit.requests[0][:6] == bytes.fromhex("000600010002")


# --- connecting --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("host", "number"),
    [
        ("no-such-host.invalid", None),
        ("x" * 300, None),
        ("255.255.255.255", errno.EACCES),
    ],
)
def test_connection_error_comes_at_once_and_says_why(
    connect: Connect, host: str, number: int | None
) -> None:
    start = time.monotonic()
    with pytest.raises(ModbusConnectionError) as caught:
        connect(f"tcp://{host}", timeout=5).read_coils(0, 1)
    assert time.monotonic() - start < LATE
    assert caught.value.__cause__ is not None
    assert number is None or caught.value.errno in (number, errno.ENETUNREACH)
    assert host[:20] in str(caught.value)


def test_connecting_counts_within_the_timeout(connect: Connect) -> None:
    with dead() as port:
        plc = connect(f"tcp://127.0.0.1:{port}", timeout=0.3)
        for attempt in (plc.connect, lambda: plc.execute(REQUEST)):
            start = time.monotonic()
            with pytest.raises(ModbusConnectionError) as caught:
                attempt()
            assert time.monotonic() - start < 0.3 + LATE
            assert caught.value.errno == errno.ETIMEDOUT
        plc.close()


def test_attempts_have_pauses_between_them_if_the_client_wants(connect: Connect) -> None:
    failures: list[float] = []

    def note(state: State, error: ModbusError | None) -> None:
        if error is not None:
            failures.append(time.monotonic())

    with refusing() as port:
        plc = connect(url_of(port), timeout=0.05, max_pause=0.3, on_state=note)
        refusals = 0
        while len(failures) < 5:
            with pytest.raises(ModbusConnectionError) as caught:
                plc.execute(REQUEST)
            assert caught.value.errno == errno.ECONNREFUSED
            assert caught.value.__cause__ is not None
            if "next attempt in" in str(caught.value):
                refusals += 1
                time.sleep(0.005)
        assert plc.statistics.failed_connects == 5
        plc.close()
    assert refusals
    for (earlier, later), pause in zip(pairwise(failures), (0.1, 0.2, 0.3, 0.3), strict=True):
        assert later - earlier >= 0.8 * pause


@pytest.mark.parametrize("max_pause", [0, 10])
def test_request_waits_for_the_next_attempt_if_it_has_time(
    connect: Connect, max_pause: float
) -> None:
    with refusing() as port:
        plc = connect(url_of(port), timeout=1, max_pause=max_pause)
        with pytest.raises(ModbusConnectionError):
            plc.connect()
        port.listen()
        start = time.monotonic()
        with ThreadPoolExecutor(1) as pool:
            waiting = pool.submit(plc.execute, REQUEST)
            with port.accept()[0] as peer:
                assert (time.monotonic() - start >= 0.08) == (max_pause > 0)
                peer.sendall(echo(peer.recv(12)))
                assert waiting.result() == [5]
        assert (plc.statistics.failed_connects, plc.statistics.connects) == (1, 1)
        plc.close()


def test_server_that_hangs_up_at_once_is_not_hammered(connect: Connect) -> None:
    with FakeServer(None) as server, connect(server.url, timeout=0.2, max_pause=30) as plc:
        end = time.monotonic() + 0.6
        while time.monotonic() < end:
            with pytest.raises((ModbusConnectionError, ModbusTimeoutError)):
                plc.execute(REQUEST)
            time.sleep(0.001)
        assert server.connections <= 5


def test_connections_that_end_are_made_anew_by_the_next_request(connect: Connect) -> None:
    """At once, before the client has read of the end, and later."""
    with FakeServer(good, None) as server, connect(server.url, max_pause=0) as plc:
        for number in range(1, 4):
            server.on_request = answering(good)
            assert plc.execute(REQUEST) == [5]
            server.drop_all()
            if number == 2:
                time.sleep(0.02)
        assert server.connections == 3
        assert plc.statistics.lost >= 2


@pytest.mark.parametrize("keepalive", [45, None])
def test_options_of_the_socket_are_set(connect: Connect, keepalive: int | None) -> None:
    with FakeServer(good) as server, connect(server.url, keepalive=keepalive) as plc:
        descriptor = os.dup(plc._driver._port.descriptor)
        with socket.socket(fileno=descriptor) as connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            probes = connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            assert probes == (keepalive is not None)
            if keepalive:
                idle = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE)
                assert idle == keepalive


def test_unplugged_port_is_a_connection_error_and_is_opened_again(
    connect: Connect, tmp_path: Path
) -> None:
    path = tmp_path / "port"
    device = Device(Mapping(holding_registers=8))
    plc = connect(f"rtu://{path}?baudrate=115200", timeout=5, max_pause=0)
    with SerialWire() as wire, ThreadPoolExecutor(1) as pool:
        path.symlink_to(wire.client)
        waiting = pool.submit(plc.execute, REQUEST)
        until(lambda: wire.passed)
        start = time.monotonic()
        wire.unplug()
        with pytest.raises(ModbusConnectionError) as caught:
            waiting.result()
        assert time.monotonic() - start < LATE
        assert caught.value.errno == errno.EIO
    path.unlink()
    with pytest.raises(ModbusConnectionError):
        plc.execute(REQUEST)
    with SerialWire() as wire, Server(device).background(f"rtu://{wire.server}"):
        path.symlink_to(wire.client)
        assert plc.execute(REQUEST) == [0]
        plc.close()


# --- what is known of it --------------------------------------------------------------------


def test_states_are_told_and_a_callback_that_fails_harms_nobody(
    connect: Connect, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[tuple[State, Any]] = []

    def note(state: State, error: ModbusError | None) -> None:
        seen.append((state, error and type(error)))
        raise ZeroDivisionError

    with FakeServer(None) as server, caplog.at_level(logging.ERROR):
        plc = connect(server.url, on_state=note)
        assert plc.state is State.DISCONNECTED
        with plc:
            assert plc.state is State.CONNECTED
            with pytest.raises(ModbusConnectionError):
                plc.execute(REQUEST)
        assert plc.state is State.CLOSED
    assert seen == [
        (State.CONNECTING, None),
        (State.CONNECTED, None),
        (State.DISCONNECTED, ModbusConnectionError),
        (State.CLOSED, None),
    ]
    assert len(caplog.records) == caplog.text.count("failed") == 4


def test_statistics_count_what_happened(connect: Connect) -> None:
    with FakeServer(good) as server, connect(server.url) as plc:
        assert plc.statistics.last_success is None
        before = time.monotonic()
        plc.execute_many([REQUEST] * 20)
        assert plc.execute(REQUEST) == [5]
        assert (plc.statistics.requests, plc.statistics.responses) == (21, 21)
        assert before <= plc.statistics.last_success <= time.monotonic()
        assert (plc.statistics.connects, plc.statistics.lost) == (1, 0)


def test_a_trace_is_told_of_what_passes(connect: Connect) -> None:
    told: list[Any] = []
    with FakeServer(good) as server, connect(server.url, trace=told.append) as plc:
        plc.execute(REQUEST)
        assert [(each.direction, each.adu) for each in told] == [
            ("sent", server.requests[0]),
            ("received", echo(server.requests[0])),
        ]
        assert {each.endpoint for each in told} == {server.url}


# --- the end --------------------------------------------------------------------------------


def test_close_is_idempotent_and_final(connect: Connect) -> None:
    with FakeServer(good) as server:
        plc = connect(server.url)
        assert not plc.closed
        plc.execute(REQUEST)
        plc.close()
        plc.close()
        assert plc.closed
        for ask in (plc.connect, lambda: plc.execute(REQUEST)):
            with pytest.raises(ModbusConnectionError, match="closed"):
                ask()
        found = plc.execute_many([REQUEST] * 3, return_exceptions=True)
        assert [type(each) for each in found] == [ModbusConnectionError] * 3


@pytest.fixture(params=["an answer", "a connection", "a pause"])
def somebody_waits(request: pytest.FixtureRequest, connect: Connect) -> Iterator[Any]:
    """A client, and what asks it and waits for long."""
    with contextlib.ExitStack() as stack:
        if request.param == "a connection":
            plc = connect(f"tcp://127.0.0.1:{stack.enter_context(dead())}", timeout=10)
        elif request.param == "an answer":
            server = stack.enter_context(FakeServer(silent))
            plc = connect(server.url, timeout=10)
        else:
            port = stack.enter_context(refusing())
            plc = connect(url_of(port), timeout=10, max_pause=30)
            while plc.statistics.failed_connects < 7:  # the next pause is 5 s and more
                plc._connection.connecting()
                plc._connection.failed(ModbusConnectionError("refused"), time.monotonic())
        yield plc
        plc.close()


def test_close_ends_what_others_wait_for(somebody_waits: Any) -> None:
    plc = somebody_waits
    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(plc.execute, REQUEST), pool.submit(plc.execute_many, [REQUEST] * 50)]
        until(lambda: plc._driver._conversation.is_wanted or plc.statistics.requests)
        start = time.monotonic()
        plc.close()
        for each in waiting:
            with pytest.raises(ModbusConnectionError):
                each.result()
        assert time.monotonic() - start < LATE
