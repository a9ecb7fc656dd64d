"""
How long things take: time-outs, pauses, repetitions, broadcasts.
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from libmodbus_py import Device, Mapping, ModbusTimeoutError, Server, ServerDeviceBusy, pdu
from tests.support.clients import EVERYWHERE, World, asking, read
from tests.support.peers import Answer, Write, answering, echo, ignore, mbap

REQUEST = pdu.ReadHoldingRegisters(5, 1)

# What the bytes of a request and its answer take on a line, and silences.
ON_LINE = 0.01


def good(request: bytes) -> list[bytes]:
    return [echo(request)]


def silent(request: bytes) -> list[bytes]:
    return []


@EVERYWHERE
def test_timeouts_of_the_client_the_handle_and_the_request(world: World) -> None:
    peer = world.peer("tcp", answering(good, silent))
    with world.connect(peer.url, timeout=30) as plc:
        assert plc.execute(REQUEST) == [5]
        plc.timeout = 0.2
        for ask, timeout in (
            (lambda: plc.execute(REQUEST), 0.2),
            (lambda: plc.for_unit(3, timeout=0.1).execute(REQUEST), 0.1),
            (lambda: plc.execute(REQUEST, timeout=0.05), 0.05),
        ):
            with (
                world.lasting(timeout),
                pytest.raises(ModbusTimeoutError, match=f"within {timeout} s"),
            ):
                ask()
        plc.timeout = 0.07
        assert plc.for_unit(3).timeout == 0.07
        with world.lasting(0.07), pytest.raises(ModbusTimeoutError, match=r"within 0.07 s"):
            plc.execute(REQUEST)


@pytest.mark.parametrize("seconds", [0.001, 0.0123, 1.0, 59.9999, 3600.0, 80_000.0])
def test_an_answer_just_before_the_end_of_the_timeout_counts(world: World, seconds: float) -> None:
    """And one behind it does not: a client that polls counts whole milliseconds."""
    late = seconds - 0.0005
    peer = world.peer("tcp", lambda request, write: write(echo(request), after=late))
    with world.connect(peer.url, timeout=seconds) as plc:
        with world.lasting(late):
            assert read(plc, 5) == 5
        late = seconds + 0.0015
        with world.lasting(seconds), pytest.raises(ModbusTimeoutError):
            read(plc, 6)


@EVERYWHERE
def test_handles_with_their_own_timeouts_share_a_connection(world: World) -> None:
    def two_units(request: bytes, write: Write) -> None:
        if request[6] == 1:
            write(echo(request))

    peer = world.peer("tcp", two_units)
    with world.connect(peer.url, timeout=20, timeouts_before_reconnect=1000) as client:
        quick = client.for_unit(2, timeout=0.05, retries=1)
        for address in range(4):
            with world.lasting(0.0):
                assert read(client, address) == address
            with world.lasting(2 * 0.05), pytest.raises(ModbusTimeoutError):
                read(quick, address)
        assert peer.connections == 1


def test_spacing_and_delay_are_kept(world: World) -> None:
    peer = world.peer("tcp", answering(good))
    options = {"request_spacing": 0.03, "connect_delay": 0.1, "timeout": 0.09}
    with world.connect(peer.url, **options) as plc:
        connected = world.now
        assert plc.execute_many([REQUEST] * 4) == [[5]] * 4
        assert plc.execute(REQUEST) == [5]
    assert peer.times[0] - connected == pytest.approx(0.1, abs=0.002)
    gaps = [later - earlier for earlier, later in pairwise(peer.times)]
    assert gaps == pytest.approx([0.03] * 4, abs=0.0015)
    assert min(gaps) >= 0.03 - 1e-6


# --- once more ------------------------------------------------------------------------------------


def test_retries_are_sent_and_counted(world: World) -> None:
    peer = world.peer("tcp", answering(silent, None, good, silent))
    with world.connect(peer.url, timeout=0.1, retries=2, max_pause=0) as plc:
        with world.lasting(0.1, more=0.01):
            assert plc.execute(REQUEST) == [5]
        assert peer.connections == 2
        assert plc.statistics.retries == 2
        for ask in (lambda: plc.execute(REQUEST, retries=0), lambda: plc.diagnostics(0, 1)):
            with world.lasting(0.1), pytest.raises(ModbusTimeoutError):
                ask()
        assert len(peer.requests) == 5


@EVERYWHERE
def test_one_timeout_before_reconnecting_and_retries(world: World) -> None:
    """The first connection is dumb; the request is repeated on the second."""
    peer = world.peer("tcp", answering(good, silent, good))
    options = {"timeout": 0.1, "retries": 1, "timeouts_before_reconnect": 1}
    with world.connect(peer.url, **options) as client:
        if not world.is_exact:
            client.timeout = 1.0
        assert read(client, 1) == 1
        assert read(client, 2) == 2
        assert read(client, 3) == 3
        assert peer.connections == 2
        assert client.statistics.retries == 1


def test_busy_devices_are_asked_again_if_the_caller_wants(world: World) -> None:
    """After 0.1 s, then after 0.2 s."""

    def busy(request: bytes) -> list[bytes]:
        return [mbap(request, b"\x83\x06")]

    answers: list[Answer] = [busy, busy, good, busy]
    peer = world.peer("tcp", answering(*answers))
    with world.connect(peer.url, busy_retries=2) as plc, world.lasting(0.3, more=0.005):
        assert read(plc, 5) == 5
    with world.connect(peer.url) as plc, world.lasting(0.0), pytest.raises(ServerDeviceBusy):
        read(plc, 5)


@pytest.mark.parametrize("kind", ["native"])
def test_a_busy_device_of_ours_is_asked_again(kind: str) -> None:
    busy = iter([ServerDeviceBusy, ServerDeviceBusy])

    def refuse(access: object) -> None:
        if error := next(busy, None):
            raise error

    device = Device(Mapping(coils=8), before_read=refuse)
    with (
        Server(device).background("tcp://127.0.0.1:0") as running,
        asking(kind, running.urls[0], busy_retries=2) as plc,
    ):
        assert plc.read_coils(0, 1) == [False]


# --- nobody answers -------------------------------------------------------------------------------


@EVERYWHERE
def test_broadcast_waits_for_no_answer_and_reads_are_refused(world: World) -> None:
    unit = world.peer("rtu", ignore)
    url = f"{unit.url}&timeout=10&turnaround=0.05&unit=0"
    with world.connect(url) as everyone:
        with world.lasting(2 * 0.05, more=ON_LINE):
            everyone.write_register(1, 2)
            everyone.write_coils(1, [True])
        with pytest.raises(ValueError, match="broadcast"):
            everyone.read_coils(0, 1)
    assert unit.requests[0][:6] == bytes.fromhex("000600010002")


# --- silence on lines -----------------------------------------------------------------------------


@EVERYWHERE
@pytest.mark.parametrize("silence", [0.03])
def test_a_request_waits_for_the_line_to_have_been_silent(world: World, silence: float) -> None:
    went: list[float] = []

    def on_request(request: bytes, write: Write) -> None:
        went.append(world.now)
        write(bytes.fromhex("01 03 02 0007 F986"))

    unit = world.peer("rtu", on_request)
    with world.connect(f"{unit.url}&silence={silence}", timeout=30) as context:
        for _ in range(5):
            assert context.read_holding_registers(0, 1) == [7]
    gaps = [came - went for came, went in zip(unit.times[1:], went, strict=False)]
    assert min(gaps) >= silence
    # The answer takes 7 characters, the request 8; a driver that polls rounds up.
    assert not world.is_exact or max(gaps) <= silence + 15 * 11 / 115_200 + 0.002
