"""
What a gateway writes to the audit trail: each write with its outcome, and each read that a rule
refuses.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import (
    Access,
    Client,
    ExceptionResponse,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    IllegalFunction,
    Rules,
    ServerDeviceBusy,
    pdu,
)
from libmodbus_py.serve import Allow, ClientRequest
from tests.services.gateway.gates import READ_ONE, adu, gated, small
from tests.simulation.lan import Lan
from tests.support.events import Events
from tests.support.gateways import passage

WRITE = bytes.fromhex("06 0001 0007")


@pytest.fixture
def events() -> Events:
    return Events()


@contextlib.contextmanager
def recorded(lan: Lan, events: Events, **options: Any) -> Iterator[Client]:
    """Return a client of unit 1 behind a gateway, which appends what it records to `events`."""
    with (
        passage(
            "tcp",
            "rtu",
            {1: small()},
            line_options="timeout=0.2",
            lan=lan,
            audit=events.append,
            **options,
        ) as through,
        through.context(1) as context,
    ):
        yield context


def rows(events: Events) -> list[tuple[str, int | None, int | None, str]]:
    return [(event.event, event.unit, event.function, event.result) for event in events]


def test_a_write_is_recorded_with_its_outcome(lan: Lan, events: Events) -> None:
    with recorded(lan, events) as context:
        context.write_register(0, 5)
        with pytest.raises(GatewayTargetFailedToRespond):
            context.for_unit(2).write_register(0, 5)
        with pytest.raises(GatewayTargetFailedToRespond):  # it is paused
            context.for_unit(2).write_register(0, 5)
        context.for_unit(0).write_register(0, 5)
        context.read_holding_registers(0, 1)
    silent = "gateway target device failed to respond (exception 11)"
    assert rows(events) == [
        ("write", 1, 6, "ok"),
        ("write", 2, 6, silent),
        ("write", 2, 6, silent),
        ("write", 0, 6, "sent"),
    ]


def test_reads_are_recorded_that_a_rule_refuses_and_no_others(lan: Lan, events: Events) -> None:
    rules = Rules({None: Allow(read=[Access("holding_registers", 0, 100)])})
    with recorded(lan, events, authorize=rules) as context:
        context.read_holding_registers(0, 1)
        with pytest.raises(IllegalFunction):
            context.read_coils(0, 1)
        with pytest.raises(IllegalFunction):
            context.write_register(0, 1)
        with pytest.raises(IllegalDataAddress):
            context.read_holding_registers(90, 1)
        for _ in range(2):
            with pytest.raises(ExceptionResponse):
                context.for_unit(2).read_holding_registers(0, 1)
    refused = "illegal function (exception 1)"
    assert rows(events) == [("refused", 1, 1, refused), ("write", 1, 6, refused)]


def test_only_an_authorize_that_raises_is_recorded_and_not_equal_answers(
    lan: Lan, events: Events
) -> None:
    def authorize(request: ClientRequest) -> bool:
        if request.function == 1:
            raise IllegalFunction
        if request.function == 2:
            raise ServerDeviceBusy
        return True

    with recorded(lan, events, authorize=authorize) as context:
        for unit in (1, 255):  # a device, and the gateway itself
            client = context.for_unit(unit)
            for read in (client.read_coils, client.read_discrete_inputs):
                with pytest.raises(ExceptionResponse):
                    read(0, 1)
            with pytest.raises(IllegalFunction):  # the device and the gateway lack this function
                client.execute(pdu.EncapsulatedTransport(13, b""))
    illegal, busy = "illegal function (exception 1)", "server device busy (exception 6)"
    assert [row for row in rows(events) if row[0] == "refused"] == [
        ("refused", unit, function, result)
        for unit in (1, 255)
        for function, result in ((1, illegal), (2, busy))
    ]


def test_a_write_of_a_disconnected_client_is_recorded_once(lan: Lan, events: Events) -> None:
    """While it waits, and after it was sent."""
    with (
        gated(lan, audit=events.append) as (gate, _, url, _),
        lan.client(url) as first,
        lan.client(url) as second,
    ):
        first.sendall(adu(WRITE))
        assert lan.until(lambda: gate.asked)
        second.sendall(adu(READ_ONE) + adu(WRITE))
        lan.pass_time(1)
        assert events == []
        first.close()
        second.reset()
        lan.pass_time(1)
        assert rows(events) == [("write", 1, 6, "no answer")]
        gate.open()
        lan.pass_time(5)
    assert rows(events) == [("write", 1, 6, "no answer"), ("write", 1, 6, "ok")]
    assert gate.kinds == ["write"]


def test_a_broadcast_of_a_disconnected_client_is_recorded_once(lan: Lan, events: Events):
    with gated(lan, audit=events.append) as (gate, _, url, _):
        with lan.client(url) as other, lan.client(url) as client:
            other.sendall(adu(READ_ONE))
            assert lan.until(lambda: gate.asked)
            client.sendall(adu(WRITE, unit=0))
            lan.pass_time(1)
            assert events == []
            client.reset()
            lan.pass_time(1)
            assert [event.unit for event in events] == [0]
            gate.open()
            lan.pass_time(5)
        writes = [event for event in events if event.unit == 0]
        assert len(writes) == 1
