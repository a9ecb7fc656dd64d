"""
Units with faults: which requests are counted, refused, executed or left to C; and what others
notice: their requests are answered, and the server stops.
"""

import socket
from contextlib import suppress
from typing import Any

import pytest

from libmodbus_py import (
    ExceptionResponse,
    GatewayTargetFailedToRespond,
    ModbusTimeoutError,
    Server,
    ServerDeviceBusy,
    ServerDeviceFailure,
    pdu,
)
from libmodbus_py.protocol.framing import Frame
from libmodbus_py.server.faults import Faults
from libmodbus_py.tools.faults.fault import KINDS, Fault
from tests.simulation.lan import Lan
from tests.tools.faults.serving import FOREVER, READ, REQUEST, adu, client_of, make_device, serving


def test_a_range_with_a_fault_leaves_the_rest_of_the_device_unchanged(lan: Lan) -> None:
    bad = Fault("exception", code=4, table="holding_registers", address=2)
    with serving(lan, "tcp", bad) as url, client_of(url) as client:
        assert client.read_holding_registers(0, 2) == [555, 0]
        with pytest.raises(ServerDeviceFailure):
            client.read_holding_registers(0, 3)
        client.write_register(1, 7)
        assert client.read_coils(2, 1) == [False]


def test_units_without_faults_are_answered_in_c(lan: Lan, monkeypatch) -> None:
    units = {1: make_device(), 2: make_device()}
    for device in units.values():
        monkeypatch.setattr(device, "_respond", lambda *_: pytest.fail("not in C"))
    fault = Fault("exception", code=6)
    with serving(lan, "tcp", fault, of=2, units=units) as url, client_of(url) as client:
        assert client.read_holding_registers(0, 3) == [555, 0, 100]
        with pytest.raises(ServerDeviceBusy):
            client.for_unit(2).read_coils(0, 1)


def test_an_answer_in_c_waits_for_an_earlier_delayed_one(lan: Lan) -> None:
    fault = Fault("delay", seconds=100)
    with serving(lan, "tcp", fault, of=2) as url, lan.client(url) as connection:
        coil = b"\x01\0\0\0\x01"
        for requests in (adu(coil, 1, 1), adu(coil, 2, 2) + adu(coil, 3, 1) + adu(coil, 4, 2)):
            connection.sendall(requests)
        answers = [(1, 1), (2, 2), (3, 1), (4, 2)]
        answer = b"".join(adu(b"\x01\x01\0", *answer) for answer in answers)
        assert connection.receive(len(answer)) == answer


def test_the_first_due_fault_is_applied_and_all_are_counted() -> None:
    own = [Fault("delay", every=2, seconds=1), Fault("no_answer", every=3)]
    faults = Faults({None: [Fault("exception", code=4)], 1: own})
    due = [faults.due(REQUEST, has_transaction=True) for _ in range(6)]
    kinds = [fault.kind if fault else "" for fault in due]
    assert kinds == ["exception", "delay", "no_answer", "delay", "exception", "delay"]
    other = faults.due(Frame(2, READ), has_transaction=True)
    assert other is not None
    assert other.kind == "exception"


def test_faults_of_all_units_also_apply_to_units_that_do_not_exist(lan: Lan) -> None:
    fault = Fault("exception", code=10, every=2)
    with serving(lan, "tcp", fault, of=None) as url, client_of(url, unit=99) as client:
        with pytest.raises(GatewayTargetFailedToRespond):
            client.read_coils(0, 1)
        with pytest.raises(ExceptionResponse, match="exception 10"):
            client.read_coils(0, 1)


def test_on_serial_lines_a_fault_does_not_count_unanswered_requests(lan: Lan) -> None:
    fault = Fault("exception", code=6, every=2)
    with serving(lan, "rtu", fault, of=None) as url, client_of(url, timeout=2) as client:
        client.for_unit(0).write_register(0, 7)
        with pytest.raises(ModbusTimeoutError):
            client.for_unit(99).read_coils(0, 1)
        assert client.read_holding_registers(0, 1) == [7]
        with pytest.raises(ServerDeviceBusy):
            client.read_holding_registers(0, 1)


def test_a_device_in_listen_only_mode_stays_silent(lan: Lan) -> None:
    fault = Fault("exception", code=6, function=3)
    with serving(lan, "rtu", fault, of=None) as url, client_of(url) as client:
        client.diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY)
        with pytest.raises(ModbusTimeoutError):
            client.read_holding_registers(0, 1)


def test_only_the_refused_write_is_not_executed(lan: Lan) -> None:
    for kind in KINDS:
        if kind in ("delay", "trickle"):
            continue
        device = make_device()
        settings: dict[str, Any] = {"code": 6} if kind == "exception" else {}
        settings |= {"length": 3} if kind in ("truncate", "garbage") else {}
        fault = Fault(kind, **settings)
        with serving(lan, "tcp", fault, units={1: device}) as url, lan.client(url) as connection:
            connection.sendall(adu(b"\x06\0\0\0\x09"))
            with suppress(OSError):  # what closes may have closed before
                connection.shutdown(socket.SHUT_WR)
            with suppress(ConnectionResetError):
                while connection.recv(100):
                    pass
        assert device.mapping.holding_registers[0] == (555 if kind == "exception" else 9), kind


@pytest.mark.parametrize("transport", ["rtu", "tcp"])
def test_event_counters_do_not_count_requests_refused_by_a_fault(lan: Lan, transport: str) -> None:
    fault = Fault("exception", code=6, function=3)
    with serving(lan, transport, fault) as url, client_of(url, timeout=2) as client:
        for _ in range(3):
            with pytest.raises(ServerDeviceBusy):
                client.read_holding_registers(0, 1)
        read = client.diagnostics
        assert read(pdu.SubFunction.BUS_EXCEPTION_ERROR_COUNT) == 3
        assert read(pdu.SubFunction.SERVER_BUSY_COUNT) == 3
        assert read(pdu.SubFunction.BUS_MESSAGE_COUNT) == 6
        assert read(pdu.SubFunction.SERVER_MESSAGE_COUNT) == 7


def test_a_response_code_gets_no_answer_and_no_fault(lan: Lan) -> None:
    fault = Fault("exception", code=6)
    with serving(lan, "tcp", fault, of=None) as url, lan.client(url) as connection:
        connection.sendall(adu(b"\x83\x01", 1) + adu(READ, 2))
        assert connection.receive(9) == adu(b"\x83\x06", 2)


@pytest.mark.parametrize(
    "fault", [Fault("delay", seconds=FOREVER), Fault("trickle", seconds=FOREVER)]
)
@pytest.mark.parametrize("unit", [1, 2])
def test_other_clients_are_answered_during_a_fault(lan: Lan, fault: Fault, unit: int) -> None:
    # The other client asks another unit, or the same one by another function.
    only = Fault(fault.kind, function=3, seconds=fault.seconds)
    with serving(lan, "tcp", only) as url, lan.client(url) as slow:
        slow.sendall(adu(READ))
        head = slow.receive(1 if fault.kind == "trickle" else 0)
        with client_of(url, unit) as client:
            for _ in range(20):
                assert client.read_coils(0, 8) == [False] * 8
        lan.pass_time(FOREVER / 2)
        assert not slow.has_input()
        assert head == (b"\0" if fault.kind == "trickle" else b"")


@pytest.mark.parametrize("change", ["switched_off", "turned_off", "replaced"])
def test_a_fault_that_is_removed_lasts_for_its_delayed_answer_only(lan: Lan, change):
    server = Server({1: make_device()})
    with server.background("tcp://10.0.0.1:0") as running, lan.client(running.urls[0]) as slow:
        switched = server.fault_switch.switch_on(Fault("delay", seconds=5))
        slow.sendall(adu(READ, 1))
        lan.pass_time(1)
        if change == "switched_off":
            switched.switch_off()
        elif change == "turned_off":
            server.fault_switch.turn(switched.states[0], is_on=False)
        else:
            server.replace({1: make_device()})
            switched.switch_off()
        start = lan.now
        with client_of(running.urls[0]) as other:
            assert other.read_holding_registers(0, 1) == [555]
        assert lan.now - start < 0.1
        slow.sendall(adu(READ, 2))  # behind the first, whose answer comes when it would have come
        lan.pass_time(3)
        assert not slow.has_input()
        answer = b"\x03\x02\x02\x2b"
        assert slow.receive(22) == adu(answer, 1) + adu(answer, 2)
        assert lan.now - start < 4.5


def test_a_server_stops_while_answers_are_delayed(lan: Lan) -> None:
    fault = Fault("delay", seconds=FOREVER)
    with serving(lan, "tcp", fault, of=None) as url:
        clients = [lan.client(url) for _ in range(5)]
        for client in clients:
            client.sendall(adu(READ))
        lan.pass_time(1)
        start = lan.now
    assert all(client.is_closed() for client in clients)
    assert lan.now - start < 0.01
    with serving(lan, "rtu", fault, of=None) as url, client_of(url, timeout=50) as line:
        with pytest.raises(ModbusTimeoutError):
            line.read_coils(0, 1)
        start = lan.now
    assert lan.now - start < 0.01


def test_a_client_that_disconnects_loses_only_its_own_answers(lan: Lan) -> None:
    with serving(lan, "tcp", Fault("delay", function=3, seconds=50)) as url:
        for _ in range(10):
            with lan.client(url) as connection:
                connection.sendall(adu(READ) * 3)
        lan.pass_time(100)
        with client_of(url) as client:
            assert client.read_holding_registers(0, 1) == [555]
