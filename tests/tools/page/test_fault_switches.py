"""
The faults of a server as its page shows and switches them.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Device, Fault, Mapping, Server
from libmodbus_py.tools.page.switches import MOST_FAULTS, Switches


@pytest.fixture
def server() -> Server:
    return Server(
        {1: Device(Mapping())}, faults={1: [Fault("no_answer")], None: [Fault("disconnect")]}
    )


def kinds(faults: Any) -> dict[Any, list[str]]:
    return {unit: [each.kind for each in found] for unit, found in faults.items()}


def test_the_faults_of_the_server_are_shown_and_on(server: Server) -> None:
    assert Switches(server).as_json() == [
        [0, 1, "no_answer", "", True],
        [1, None, "disconnect", "", True],
    ]


def test_a_fault_is_shown_with_its_words(server: Server) -> None:
    switches = Switches(server)
    switches.add(7, Fault("exception", code=2, function=3))
    switches.add(None, Fault("delay", seconds=1.5))
    texts = [each[3] for each in switches.as_json()[2:]]
    assert texts == ["function 3, code 2", "seconds 1.5"]


def test_what_is_off_is_not_in_the_server_and_comes_back(server: Server) -> None:
    switches = Switches(server)
    switches.switch(0, "no_answer", is_on=False)
    assert kinds(server.faults) == {None: ["disconnect"]}
    assert [each[-1] for each in switches.as_json()] == [False, True]
    switches.switch(0, "no_answer", is_on=True)
    assert kinds(server.faults) == {1: ["no_answer"], None: ["disconnect"]}


@pytest.mark.parametrize(
    ("number", "kind"), [(-1, "disconnect"), (2, "disconnect"), (0, "disconnect")]
)
def test_a_fault_that_is_not_there_is_refused(server: Server, number: int, kind: str) -> None:
    switches = Switches(server)
    with pytest.raises(ValueError, match="no such fault"):
        switches.switch(number, kind, is_on=False)
    assert kinds(server.faults) == {1: ["no_answer"], None: ["disconnect"]}


def test_there_may_be_so_many_and_no_more(server: Server) -> None:
    switches = Switches(server)
    for _ in range(MOST_FAULTS - 2):
        switches.add(None, Fault("no_answer"))
    assert MOST_FAULTS == 200
    assert len(switches.as_json()) == 200
    with pytest.raises(ValueError, match="there are 200 faults"):
        switches.add(None, Fault("no_answer"))
    assert len(switches.as_json()) == 200


def test_what_others_change_is_followed(server: Server) -> None:
    switches = Switches(server)
    switches.switch(0, "no_answer", is_on=False)
    before = switches.follow()
    assert switches.follow() == before
    server.replace(server.devices, {3: [Fault("disconnect")]})
    assert switches.follow() == before + 1
    assert switches.as_json() == [[0, 3, "disconnect", "", True]]
    # What was added is put beside it, and not beside what was there before.
    switches.add(None, Fault("no_answer"))
    assert kinds(server.faults) == {3: ["disconnect"], None: ["no_answer"]}


def test_a_change_is_followed_before_it_is_switched(server: Server) -> None:
    switches = Switches(server)
    switches.follow()
    server.replace(server.devices, {3: [Fault("disconnect")]})
    switches.switch(0, "disconnect", is_on=False)
    assert kinds(server.faults) == {}


def test_each_change_has_another_version(server: Server) -> None:
    switches = Switches(server)
    seen = [switches.follow()]
    switches.switch(0, "no_answer", is_on=False)
    seen.append(switches.follow())
    switches.add(1, Fault("no_answer"))
    seen.append(switches.follow())
    assert len(set(seen)) == 3
