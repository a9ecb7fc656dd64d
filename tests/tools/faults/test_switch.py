"""The fault switch of a server: several users, none of whom undoes what another one did."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from libmodbus_py import Client, Device, Fault, Mapping, ModbusError, Server
from tests.support.cases import each_case

GIVEN = Fault("exception", code=4)
MINE = Fault("exception", code=5)
YOURS = Fault("exception", code=6)


def make_server(*faults: Fault) -> Server:
    return Server({1: Device(Mapping(holding_registers={0: [7]}))}, faults={1: faults})


def happening(server: Server) -> list[tuple[int | None, int | None]]:
    """The unit and exception code of each fault that is on."""
    return [(state.unit, state.fault.code) for state in server.fault_switch.states() if state.is_on]


def code_of(client: Client) -> int | None:
    try:
        client.read_holding_registers(0, 1)
    except ModbusError as error:
        return getattr(error, "code", None)
    return None


def test_the_latest_fault_comes_first_and_those_of_the_server_last() -> None:
    server = make_server(GIVEN)
    mine = server.fault_switch.switch_on(MINE, MINE)
    server.fault_switch.switch_on(YOURS, unit=1)
    assert happening(server) == [(1, 6), (None, 5), (None, 5), (1, 4)]
    mine.switch_off()
    mine.switch_off()
    assert happening(server) == [(1, 6), (1, 4)]


def test_one_fault_is_turned_off_and_on_again_in_its_place() -> None:
    server = make_server(GIVEN, MINE)
    yours = server.fault_switch.switch_on(YOURS)
    first = server.fault_switch.states()[0]
    state = server.fault_switch.states()[1]
    with server.background("tcp://127.0.0.1:0") as running:
        client = Client(running.urls[0], unit=1)
        with client:
            server.fault_switch.turn(state, is_on=False)
            assert code_of(client) == 5
            server.fault_switch.turn(first, is_on=False)
            server.fault_switch.turn(state, is_on=True)
            assert code_of(client) == 4
    assert [state.fault for state in server.fault_switch.states()] == [YOURS, GIVEN, MINE]
    yours.switch_off()
    with pytest.raises(ValueError, match="the server does not have the fault Fault"):
        server.fault_switch.turn(first, is_on=True)


def test_replace_changes_only_the_faults_given_to_the_server() -> None:
    server = make_server(GIVEN)
    mine = server.fault_switch.switch_on(MINE, unit=1)
    server.replace(server.devices, faults={1: [YOURS]})
    assert happening(server) == [(1, 5), (1, 6)]
    assert server.faults == {1: [YOURS]}
    server.replace(server.devices, faults=server.faults)
    assert happening(server) == [(1, 5), (1, 6)]
    mine.switch_off()
    assert happening(server) == [(1, 6)]


def test_removed_faults_keep_their_counts() -> None:
    server = make_server()
    second = Fault("exception", code=6, every=2)
    codes = []
    with (
        server.fault_switch.switch_on(second, unit=1),
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1) as client,
    ):
        for _ in range(4):
            codes.append(code_of(client))
            server.fault_switch.switch_on(MINE, unit=2).switch_off()
    assert codes == [None, 6, None, 6]


@each_case(
    ("faults", "unit", "message"),
    [
        ((5,), 1, "faults must be"),
        ((MINE,), 256, r"unit must be in 0..255, not 256"),
        ((MINE,), "1", "unit must be an integer"),
    ],
)
def test_a_wrong_argument_changes_no_fault(faults: Any, unit: Any, message: str) -> None:
    server = make_server(GIVEN)
    with pytest.raises((TypeError, ValueError), match=message):
        server.fault_switch.switch_on(*faults, unit=unit)
    assert happening(server) == [(1, 4)]


def test_refused_devices_change_no_fault() -> None:
    server = make_server(GIVEN)
    with pytest.raises(TypeError, match="must be a Device"):
        server.replace({1: 5}, faults={1: [YOURS]})  # type: ignore[dict-item]
    assert happening(server) == [(1, 4)]
    assert server.faults == {1: [GIVEN]}


def test_many_threads_leave_only_the_faults_given_to_the_server() -> None:
    server = make_server(GIVEN)

    def switching() -> None:
        for _ in range(50):
            with server.fault_switch.switch_on(MINE), server.fault_switch.switch_on(YOURS, unit=1):
                pass

    with ThreadPoolExecutor(4) as pool:
        switchings = [pool.submit(switching) for _ in range(4)]
    assert not any(switching.exception() for switching in switchings)
    assert happening(server) == [(1, 4)]
