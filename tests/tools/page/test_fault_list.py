"""
The faults of a server as its page lists and switches them.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Device, Fault, Mapping, Server
from libmodbus_py.tools.page.fault_list import MOST_FAULTS, FaultList
from libmodbus_py.tools.testing.recording import RecordingServer

GIVEN = {1: [Fault("no_answer")], None: [Fault("disconnect")]}


@pytest.fixture
def server() -> Server:
    return Server({1: Device(Mapping())}, faults=GIVEN)


def listed(server: Server) -> FaultList:
    return FaultList(server.fault_switch)


def happening(server: Server) -> list[tuple[int | None, str]]:
    """The unit and kind of each fault that is on."""
    return [(each.unit, each.fault.kind) for each in server.fault_switch.states() if each.is_on]


def test_the_faults_of_the_server_are_listed_and_on(server: Server) -> None:
    assert listed(server).as_json() == [
        [0, 1, "no_answer", "", True],
        [1, None, "disconnect", "", True],
    ]


def test_a_fault_is_listed_with_its_settings(server: Server) -> None:
    faults = listed(server)
    faults.as_json()
    faults.add(7, Fault("exception", code=2, function=3))
    faults.as_json()
    faults.add(None, Fault("delay", seconds=1.5))
    assert [each[3] for each in faults.as_json()[2:]] == ["function 3, code 2", "seconds 1.5"]


def test_what_is_off_does_not_happen_and_comes_back(server: Server) -> None:
    faults = listed(server)
    faults.turn(0, is_on=False)
    assert happening(server) == [(None, "disconnect")]
    assert [each[-1] for each in faults.as_json()] == [False, True]
    faults.turn(0, is_on=True)
    assert happening(server) == [(1, "no_answer"), (None, "disconnect")]


@pytest.mark.parametrize("number", [-1, 2])
def test_a_fault_that_is_not_there_is_refused(server: Server, number: int) -> None:
    with pytest.raises(ValueError, match="fault no longer exists"):
        listed(server).turn(number, is_on=False)
    assert len(happening(server)) == 2


def test_there_may_be_so_many_and_no_more(server: Server) -> None:
    faults = listed(server)
    for _ in range(MOST_FAULTS - 2):
        faults.add(None, Fault("no_answer"))
    assert MOST_FAULTS == 200
    assert len(faults.as_json()) == 200
    with pytest.raises(ValueError, match="there are 200 faults"):
        faults.add(None, Fault("no_answer"))
    assert len(faults.as_json()) == 200


def test_what_others_change_is_followed(server: Server) -> None:
    faults = listed(server)
    faults.turn(0, is_on=False)
    before = faults.version
    server.replace(server.devices, {3: [Fault("disconnect")]})
    assert faults.version != before
    assert faults.as_json() == [[2, 3, "disconnect", "", True]]
    with pytest.raises(ValueError, match="fault no longer exists"):
        faults.turn(0, is_on=True)


def test_equal_faults_are_switched_each_for_itself() -> None:
    server = Server({1: Device(Mapping())}, {1: [Fault("no_answer"), Fault("no_answer")]})
    faults = listed(server)
    faults.turn(1, is_on=False)
    assert [each[-1] for each in faults.as_json()] == [True, False]


def test_a_page_and_the_pytest_plugin_do_not_undo_each_other() -> None:
    recording = RecordingServer(["tcp://127.0.0.1:0"], Device(Mapping(coils=8)), None)
    try:
        faults = FaultList(recording.faults)
        with recording.faults.switch_on(Fault("exception", code=6)):
            faults.add(None, Fault("no_answer"))
            assert [each[2] for each in faults.as_json()] == ["exception", "no_answer"]
            faults.turn(1, is_on=False)
            assert [each.is_on for each in recording.faults.states()] == [False, True]
        assert [(each[2], each[4]) for each in faults.as_json()] == [("no_answer", False)]
    finally:
        recording.close()
