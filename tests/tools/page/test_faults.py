"""
The faults of a server as its page lists, switches and adds them.
"""

from __future__ import annotations

import pytest

from libmodbus_py import (
    Context,
    Device,
    Fault,
    Mapping,
    ModbusTimeoutError,
    ServerDeviceBusy,
)
from tests.tools.page.watching import shown, until

GIVEN = {1: [Fault("exception", code=6, function=3)], None: [Fault("no_answer", function=1)]}


def test_faults_are_switched_off_and_on() -> None:
    with (
        shown(faults=GIVEN) as (_, url, visitor),
        visitor.watching(),
        Context.from_url(url, unit=1, timeout=5) as plc,
    ):
        assert visitor.rows("faults") == [
            [1, "exception", "function 3, code 6", True],
            [None, "no_answer", "function 1", True],
        ]
        number = min(map(int, visitor.seen["faults"]))
        with pytest.raises(ServerDeviceBusy):
            plc.read_holding_registers(0, 1)
        assert visitor.post("/fault", number=number, on=False) == {}
        visitor.receive(lambda: not visitor.rows("faults")[0][3])
        until(lambda: _reads(plc))
        visitor.post("/fault", number=number, on=True)
        until(lambda: not _reads(plc))
        found = visitor.post("/fault", number=number + 1000, on=True)
        assert found == "this fault no longer exists"


def _reads(plc: Context) -> bool:
    try:
        plc.read_holding_registers(0, 1)
    except ServerDeviceBusy:
        return False
    return True


def test_a_fault_is_added() -> None:
    with shown() as (server, url, visitor), visitor.watching():
        body = {"unit": 2, "kind": "no_answer", "function": 3, "every": None, "seconds": None}
        assert visitor.post("/faults", **body) == {}
        visitor.receive(lambda: visitor.seen["faults"])
        (state,) = server.fault_switch.states()
        assert (state.unit, state.fault) == (2, Fault("no_answer", function=3))
        with Context.from_url(url, unit=2, timeout=0.3) as plc, pytest.raises(ModbusTimeoutError):
            until(lambda: plc.read_holding_registers(0, 1) is None)
        for wrong, text in (
            ({"unit": 2, "kind": "delay"}, "seconds is missing"),
            ({"unit": None, "kind": "explode"}, "kind must be one of delay"),
            ({"unit": 3, "kind": "no_answer"}, "there is no unit 3"),
            ({"unit": 2, "kind": "delay", "seconds": "soon"}, "seconds must be"),
            ({"unit": 2, "kind": ["delay"]}, "kind must be one of"),
        ):
            assert text in visitor.post("/faults", **wrong)


def test_others_may_change_devices_and_faults() -> None:
    with shown() as (server, _, visitor), visitor.watching():
        visitor.look(1, "holding_registers", 0, 8)
        visitor.receive(lambda: visitor.cells("1/holding_registers"))
        mapping = Mapping(holding_registers={0: [77] * 8})
        server.replace({1: Device(mapping)}, {1: [Fault("no_answer")]})
        visitor.receive(
            lambda: visitor.cells("1/holding_registers")[0] == 77 and visitor.seen["faults"]
        )
        assert [each["number"] for each in visitor.rows("units")] == [1]
        assert visitor.rows("units")[0]["tables"] == {"holding_registers": [[0, 8]]}
        server.replace({3: Device(mapping)})
        visitor.receive(lambda: list(visitor.seen["units"]) == ["3"])
        assert "1/holding_registers" not in visitor.seen
        visitor.look(3, "holding_registers", 0, 8)
        visitor.receive(lambda: visitor.cells("3/holding_registers"))


def test_there_may_be_so_many_and_no_more() -> None:
    given = [Fault("delay", seconds=1.5), *[Fault("no_answer")] * 198]
    with shown(faults={1: given}) as (server, _, visitor), visitor.watching():
        assert visitor.rows("faults")[0] == [1, "delay", "seconds 1.5", True]
        number = max(map(int, visitor.seen["faults"]))  # equal ones are switched one by one
        assert visitor.post("/fault", number=number, on=False) == {}
        assert [each.is_on for each in server.fault_switch.states()] == [True] * 198 + [False]
        fault = {"unit": 2, "kind": "no_answer"}
        assert visitor.post("/faults", **fault) == {}
        assert "there are 200 faults already" in visitor.post("/faults", **fault)
