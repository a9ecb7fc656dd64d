"""
Register maps on both clients: what is read and written, in which requests, and what is refused
before a byte is sent.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py import (
    Device,
    Hook,
    IllegalDataAddress,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    NoValue,
    Point,
    RegisterMap,
    Server,
    ServerDeviceBusy,
    pdu,
)
from tests.support.cases import each_case
from tests.support.clients import Connect

H = "holding_registers"

METER = RegisterMap(
    [
        Point("setpoint", H, 100, scale=0.1, units="°C", minimum=5, maximum=30),
        Point("energy", H, 101, type="uint32", order="CDAB", scale=0.001, units="kWh"),
        Point("name", H, 103, type="string:6"),
        Point("flow", H, 110, type="float32", access="read"),
        Point("key", H, 120, access="write"),
        Point("volts", "input_registers", 0, 3, scale=0.1, units="V"),
        Point("run", "coils", 7),
        Point("alarms", "discrete_inputs", 0, 3),
    ]
)

VALUES = {
    "setpoint": 21.5,
    "energy": 123456.789,
    "name": "boiler",
    "flow": 0.15625,
    "volts": [230.5, 231.0, 0.1],
    "run": True,
    "alarms": [False, True, False],
}


@contextmanager
def serving(connect: Connect, device: Device) -> Iterator[Any]:
    """A client of the device."""
    with (
        Server(device).background("tcp://127.0.0.1:0") as running,
        connect(running.urls[0], timeout=5) as plc,
    ):
        yield plc


@pytest.fixture
def tables() -> Mapping:
    energy = 123456789
    name = [0x626F, 0x696C, 0x6572]
    return Mapping(
        coils=range(20),
        discrete_inputs={0: [False, True, False]},
        holding_registers={
            100: [215, energy & 0xFFFF, energy >> 16, *name],
            110: [0x3E20, 0],
            120: [0],
        },
        input_registers={0: [2305, 2310, 1]},
    )


@pytest.fixture
def reads() -> list[Any]:
    return []


@pytest.fixture
def meter(tables: Mapping, reads: list[Any]) -> Iterator[str]:
    tables.coils[7] = True

    def note(access: Any) -> None:
        reads.append((access.table, access.address, access.count))

    with Server(Device(tables, before_write=note)).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_names_become_scaled_values(connect: Connect, meter: str) -> None:
    with connect(meter, timeout=5) as plc:
        assert repr(plc.read_map(METER)) == repr(VALUES)
        assert plc.read_map(METER, ["run", "setpoint"]) == {"run": True, "setpoint": 21.5}
        assert list(plc.read_map(METER, ["run", "setpoint"])) == ["run", "setpoint"]
        assert plc.for_unit(3).read_map(METER, ("volts",), gap=4) == {"volts": VALUES["volts"]}
        assert plc.read_map(METER, []) == {}
        assert plc.read_many(METER.plan()) == VALUES


def test_values_are_written_and_neighbours_together(
    connect: Connect, meter: str, tables: Mapping, reads: list[Any]
) -> None:
    values = {"run": False, "energy": 7.5, "setpoint": 5, "key": 99, "name": "x"}
    with connect(meter, timeout=5) as plc:
        assert plc.write_map(METER, values) is None
        assert reads == [(H, 100, 6), (H, 120, 1), ("coils", 7, 1)]
        assert tables.holding_registers[100:106] == [50, 7500, 0, 0x7800, 0, 0]
        assert tables.holding_registers[120] == 99
        assert tables.coils[7] is False
        plc.write_map(METER, {})
        assert len(reads) == 3
        plc.for_unit(9).write_map(METER, {"setpoint": 29.97})
        assert plc.read_map(METER, ["setpoint"]) == {"setpoint": 30.0}


MULTIPLE, SINGLE = {"write_function": "multiple"}, {"write_function": "single"}

WRITES = [
    ({"key": 1}, {}, [pdu.WriteRegister(120, 1)]),
    ({"key": 1}, MULTIPLE, [pdu.WriteRegisters(120, [1])]),
    ({"run": 1}, {}, [pdu.WriteCoil(7, True)]),
    ({"run": False}, MULTIPLE, [pdu.WriteCoils(7, [False])]),
    ({"run": False}, SINGLE, [pdu.WriteCoil(7, False)]),
    ({"name": "ab", "setpoint": 5}, {}, [
        pdu.WriteRegister(100, 50), pdu.WriteRegisters(103, [0x6162, 0, 0]),
    ]),
    ({"energy": 0.001, "setpoint": 5}, {}, [pdu.WriteRegisters(100, [50, 1, 0])]),
    ({"energy": 0.001, "setpoint": 5}, SINGLE, [
        pdu.WriteRegister(100, 50), pdu.WriteRegister(101, 1), pdu.WriteRegister(102, 0),
    ]),
]  # fmt: skip


@each_case(("values", "options", "requests"), WRITES)
def test_few_requests_write_all_the_values(values: Any, options: Any, requests: list[Any]) -> None:
    assert METER.writes(values, **options) == requests


def test_long_writes_are_split_between_values() -> None:
    long = RegisterMap(
        [
            Point("head", H, 0),
            Point("block", H, 1, 61, "uint32"),
            Point("tail", H, 123, 100, "uint32"),
            Point("bits", "coils", 0, 2000),
        ]
    )
    values = {"head": 7, "block": [1] * 61, "tail": [2] * 100, "bits": [True] * 2000}
    ranges = [(item.address, len(item.values)) for item in long.writes(values)]  # type: ignore[attr-defined]
    # 123 registers at most; `tail` is longer than a request, and begins one of its own.
    assert ranges == [(0, 123), (123, 122), (245, 78), (0, 1968), (1968, 32)]


def test_values_that_fit_into_one_request_are_not_split() -> None:
    blocks = RegisterMap([Point("first", H, 0, 100), Point("second", H, 100, 50)])
    requests = blocks.writes({"first": [1] * 100, "second": [2] * 50})
    assert requests == [pdu.WriteRegisters(0, [1] * 100), pdu.WriteRegisters(100, [2] * 50)]


# What is written, and why nothing of it is sent.
REFUSED = [
    ({"setpiont": 1}, ValueError, "the map has no point 'setpiont'; did you mean setpoint?"),
    ({7: 1}, ValueError, "the map has no point 7"),
    ({"setpoint": 5, "flow": 1.0}, ValueError, "flow cannot be written: its access is read"),
    ({"volts": [1, 2, 3]}, ValueError, "volts cannot be written: its access is read"),
    ({"key": 1, "setpoint": 4.9}, ValueError, "setpoint: value must be in 5..30, not 4.9"),
    ({"key": 1, "name": 7}, TypeError, "name: value must be a string, not int"),
    ([("key", 1)], TypeError, "values must be a mapping from names to values, not list"),
]


def test_one_wrong_value_prevents_all_requests(connect: Connect, meter: str, reads: list[Any]):
    with connect(meter, timeout=5) as plc:
        for values, kind, message in REFUSED:
            with pytest.raises(kind, match=f"^{re.escape(message)}$"):
                plc.write_map(METER, values)
        assert plc.statistics.requests == 0
    assert reads == []


UNREADABLE = [
    (["volt"], ValueError, "the map has no point 'volt'; did you mean volts?"),
    (["key"], ValueError, "key cannot be read: its access is write"),
    ("volts", TypeError, "names must be a list of names, not str"),
    (7, TypeError, "names must be a list of names, not int"),
]


def test_names_that_cannot_be_read(connect: Connect, meter: str) -> None:
    with connect(meter, timeout=5) as plc:
        for names, kind, message in UNREADABLE:
            with pytest.raises(kind, match=f"^{re.escape(message)}$"):
                plc.read_map(METER, names)
        for call in (plc.read_map, plc.write_map):
            with pytest.raises(TypeError, match="map must be a RegisterMap or the path of"):
                call({}, {})


def test_a_point_that_failed_has_its_error(connect: Connect) -> None:
    """Its neighbours have their values."""
    holes = RegisterMap(
        [
            Point("there", H, 0),
            Point("missing", H, 5),
            Point("beside", H, 6),
            Point("digits", H, 10, type="bcd16"),
        ]
    )
    # 6 is there, but touches 5, which is not.
    device = Device(Mapping(holding_registers={0: [7], 6: [8], 10: [0xF]}))
    with serving(connect, device) as plc:
        results = plc.read_map(holes, return_exceptions=True)
        assert results["there"] == 7
        assert isinstance(results["missing"], IllegalDataAddress)
        assert results["beside"] == 8
        assert isinstance(results["digits"], NoValue)
        assert str(results["digits"]) == "digits has no value: 000F has digits other than 0..9"
        with pytest.raises(IllegalDataAddress):
            plc.read_map(holes)
        assert plc.read_map(holes, ["there", "digits"]) == {"there": 7, "digits": None}
        for gap in (0, 5):  # a gap reads what nobody asked for, and is refused
            assert plc.read_map(holes, ["there", "beside"], gap=gap) == {"there": 7, "beside": 8}


def test_invalid_data_of_one_point_leaves_the_other_points(connect: Connect) -> None:
    """A text of a solar inverter with a byte that is not ASCII, behind its end and in it."""
    cells = [42, *[0x564E, 0x00FF, 0x0700], *[0x564E, 0xFF00, 0], 0xFFFF, 0xFFFF, 0x13, 0]
    types = {"soc": "uint16", "name": "string:6", "bad": "string:6", "level": "bcd16"}
    at = {"soc": 0, "name": 1, "bad": 4, "level": 7, "clock": 8}
    points = RegisterMap(
        [Point(name, H, at[name], type=types.get(name, "date48")) for name in at]  # type: ignore[arg-type]
    )
    good = {"soc": 42, "name": "VN"}
    with serving(connect, Device(Mapping(holding_registers={0: cells}))) as plc:
        assert plc.read_map(points) == {**good, "bad": None, "level": None, "clock": None}
        results = plc.read_map(points, return_exceptions=True)
        reasons = {name: result.reason for name, result in results.items() if name not in good}
        assert reasons == {"bad": "InvalidData", "level": "InvalidData", "clock": "InvalidTime"}
        for call, reason, text in (
            (lambda: plc.read_value(H, 4, "string:6"), "InvalidData", f"{H} 4 has no value: 56"),
            (lambda: plc.read_values(H, 7, "bcd16", 3), "InvalidData", f"{H} 7 has no value: FFFF"),
            (lambda: plc.read_value(H, 8, "date48"), "InvalidTime", f"{H} 8 has no value: FF FF"),
            (lambda: plc.read_many([(H, 0), (H, 7, 1, "bcd16")]), "InvalidData", "items[1] has no"),
        ):
            with pytest.raises(NoValue) as caught:
                call()
            assert isinstance(caught.value, ModbusError)
            assert caught.value.reason == reason
            assert str(caught.value).startswith(text)
        items = {"soc": (H, 0), "levels": (H, 7, 3, "bcd16"), "level": (H, 7, 1, "bcd16")}
        several = plc.read_many(items, return_exceptions=True)
        assert (several["soc"], several["levels"]) == ([42], [None, None, 13])
        assert isinstance(several["level"], NoValue)


def test_each_point_has_the_error_of_a_lost_line(connect: Connect) -> None:
    with serving(connect, Device(Mapping(holding_registers=9))) as plc:
        plc.close()
        errors = plc.read_map(METER, ["setpoint", "run"], return_exceptions=True)
        assert [type(error) for error in errors.values()] == [ModbusConnectionError] * 2
        with pytest.raises(ModbusConnectionError):
            plc.read_map(METER)
        with pytest.raises(ModbusConnectionError):
            plc.write_map(METER, {"setpoint": 20})


def test_a_broadcast_has_no_answer(connect: Connect) -> None:
    device = Device(Mapping(holding_registers=200, coils=9))
    with (
        Server(device).background("rtu+tcp://127.0.0.1:0") as running,
        connect(running.urls[0], unit=0, timeout=5) as plc,
    ):
        plc.write_map(METER, {"setpoint": 20, "run": True})
        with pytest.raises(ValueError, match="unit 0 is a broadcast"):
            plc.read_map(METER)
        assert plc.for_unit(1).read_map(METER, ["setpoint", "run"]) == {
            "setpoint": 20.0,
            "run": True,
        }


def test_writes_after_a_refused_one_are_not_sent(connect: Connect) -> None:
    def refuse(access: Any) -> None:
        raise ServerDeviceBusy

    hook = Hook(refuse, holding_registers=[range(2, 3)])
    device = Device(Mapping(holding_registers=10), before_write=hook)
    steps = RegisterMap([Point(f"p{at}", H, at) for at in (4, 2, 0)])
    with serving(connect, device) as plc:
        with pytest.raises(ServerDeviceBusy):
            plc.write_map(steps, {"p0": 1, "p2": 1, "p4": 1})
        assert plc.read_holding_registers(0, 5) == [0, 0, 0, 0, 1]


def test_a_map_returns_the_same_plan_for_equal_arguments() -> None:
    assert METER.plan() is METER.plan()
    assert METER.plan(["run"], gap=2) is METER.plan(iter(["run"]), gap=2)
    assert METER.plan(["run"], gap=2) is not METER.plan(["run"])
    forbidden = [("coils", range(7, 8))]
    METER.plan(["volts"], forbidden=forbidden)
    forbidden.append(("input_registers", range(1, 2)))
    with pytest.raises(ValueError, match="touches the forbidden"):
        METER.plan(["volts"], forbidden=forbidden)


def test_a_map_is_an_immutable_mapping() -> None:
    assert list(METER)[:2] == ["setpoint", "energy"]
    assert METER["run"] == Point("run", "coils", 7)
    assert len(METER) == 8
    assert repr(RegisterMap([METER["run"]])) == "<RegisterMap of 1 points: ['run']>"
    with pytest.raises(TypeError):
        METER["run"] = METER["key"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        METER.more = 1  # type: ignore[attr-defined]
    with pytest.raises(AttributeError):
        METER["run"].address = 8  # type: ignore[misc]
    with pytest.raises(ValueError, match=r"^name 'run' occurs twice$"):
        RegisterMap([METER["run"], METER["run"]])
    with pytest.raises(TypeError, match=r"^points must be Point objects, not str$"):
        RegisterMap(["run"])  # type: ignore[list-item]


GROUPS = RegisterMap(
    [
        Point("a", "holding_registers", 0, group="x"),
        Point("b", "holding_registers", 1, group="y"),
        Point("c", "holding_registers", 2, group="x"),
        Point("d", "holding_registers", 3, group="x", access="write"),
        Point("e", "holding_registers", 4, group="z", access="write"),
    ]
)


def test_a_group_has_the_points_that_can_be_read() -> None:
    assert GROUPS.group("x") == ["a", "c"]


@each_case("name", ["", "z", "X"])
def test_an_unknown_group_is_named(name: str) -> None:
    with pytest.raises(ValueError, match=f"no points of a group '{name}'; its groups are x, y"):
        GROUPS.group(name)
