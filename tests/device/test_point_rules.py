"""Access and bounds of points: what clients are answered, in C and in Python, before any hook."""

import struct
from typing import Any

from libmodbus_py import Access, Allow, Device, Mapping, Point, RegisterMap, Rules, pdu
from libmodbus_py.serve import Caller
from tests.device.devices import contents
from tests.support.cases import each_case

MAP = RegisterMap(
    [
        Point("setpoint", "holding_registers", 0, scale=0.1, minimum=5, maximum=30),
        Point("limit", "holding_registers", 1, type="int32", minimum=-5, maximum=70_000),
        Point("energy", "holding_registers", 3, type="uint32", access="read"),
        Point("mode", "holding_registers", 5),
        Point("key", "holding_registers", 6, access="write"),
        Point("ratio", "holding_registers", 7, type="float32", minimum=0.1, maximum=0.7),
        Point("digits", "holding_registers", 9, type="bcd16", maximum=5000),
        Point("run", "coils", 0),
        Point("local", "coils", 1, access="read"),
        Point("flow", "input_registers", 0, minimum=3),
        Point("secret", "coils", 2, access="write"),
    ]
)

OUT_OF_BOUNDS, NO_ADDRESS = 3, 2

# Request -> the code of the exception, 0 for none.
REQUESTS: list[tuple[pdu.Request[Any], int]] = [
    (pdu.WriteRegister(0, 50), 0),
    (pdu.WriteRegister(0, 300), 0),
    (pdu.WriteRegister(0, 49), OUT_OF_BOUNDS),
    (pdu.WriteRegister(0, 301), OUT_OF_BOUNDS),
    (pdu.WriteRegister(0, 65535), OUT_OF_BOUNDS),
    (pdu.MaskWriteRegister(0, 0, 301), OUT_OF_BOUNDS),
    (pdu.MaskWriteRegister(0, 0, 299), 0),
    (pdu.WriteRegisters(1, [1, 0x1170]), 0),  # 70 000
    (pdu.WriteRegisters(1, [1, 0x1171]), OUT_OF_BOUNDS),
    (pdu.WriteRegisters(1, [0xFFFF, 0xFFFB]), 0),  # -5
    (pdu.WriteRegisters(1, [0xFFFF, 0xFFFA]), OUT_OF_BOUNDS),
    (pdu.WriteRegister(1, 0xFFFF), OUT_OF_BOUNDS),  # half of it: -65 536
    (pdu.WriteRegister(2, 9), 0),
    (pdu.WriteRegister(1, 2), OUT_OF_BOUNDS),
    (pdu.WriteRegisters(0, [50, 0, 7]), 0),
    (pdu.WriteRegisters(0, [50, 2, 7]), OUT_OF_BOUNDS),
    (pdu.WriteRegisters(0, [5, 0, 7]), OUT_OF_BOUNDS),
    (pdu.WriteRegisters(0, [50, 0, 7, 0]), NO_ADDRESS),
    (pdu.WriteRegister(3, 0), NO_ADDRESS),
    (pdu.WriteRegister(4, 0), NO_ADDRESS),
    (pdu.WriteRegister(5, 65535), 0),
    (pdu.WriteRegister(6, 1), 0),
    (pdu.WriteRegister(10, 1), NO_ADDRESS),
    (pdu.WriteRegisters(9, [1, 2]), NO_ADDRESS),
    (pdu.ReadHoldingRegisters(0, 6), 0),
    (pdu.ReadHoldingRegisters(0, 7), NO_ADDRESS),
    (pdu.ReadHoldingRegisters(6, 1), NO_ADDRESS),
    (pdu.ReadHoldingRegisters(7, 3), 0),
    (pdu.ReadHoldingRegisters(9, 2), NO_ADDRESS),
    (pdu.ReadInputRegisters(0, 1), 0),
    (pdu.WriteRegisters(7, struct.unpack(">2H", struct.pack(">f", 0.1))), 0),
    (pdu.WriteRegisters(7, struct.unpack(">2H", struct.pack(">f", 0.7))), 0),
    (pdu.WriteRegisters(7, struct.unpack(">2H", struct.pack(">f", 0.7001))), OUT_OF_BOUNDS),
    (pdu.WriteRegisters(7, [0x7FC0, 0]), OUT_OF_BOUNDS),  # nan
    (pdu.WriteRegisters(7, [0x7F80, 0]), OUT_OF_BOUNDS),  # infinity
    (pdu.WriteRegister(9, 0x5000), 0),
    (pdu.WriteRegister(9, 0x5001), OUT_OF_BOUNDS),
    (pdu.WriteRegister(9, 0x000A), OUT_OF_BOUNDS),  # no decimal digit
    (pdu.ReadWriteRegisters(0, 6, 0, [301]), OUT_OF_BOUNDS),
    (pdu.ReadWriteRegisters(0, 7, 0, [300]), NO_ADDRESS),
    (pdu.ReadWriteRegisters(0, 6, 3, [300]), NO_ADDRESS),
    (pdu.ReadWriteRegisters(0, 6, 0, [300]), 0),
    (pdu.WriteCoil(0, True), 0),
    (pdu.WriteCoil(1, True), NO_ADDRESS),
    (pdu.WriteCoils(0, [True, True]), NO_ADDRESS),
    (pdu.WriteCoil(2, True), 0),
    (pdu.ReadCoils(0, 2), 0),
    (pdu.ReadCoils(0, 3), NO_ADDRESS),
]


def plant() -> Device:
    return Device.of_map(MAP, {"setpoint": 20, "ratio": 0.5})


@each_case(("request_", "code"), REQUESTS)
def test_requests_against_rules_of_a_map_are_refused(request_: pdu.Request[Any], code: int) -> None:
    device = plant()
    before = contents(device)
    response = device.answer(request_.encode())
    function = request_.function
    assert response[:2] == bytes([function | 0x80, code]) if code else response[0] == function
    if code or function <= 4:
        assert contents(device) == before


def test_requests_in_one_chunk_get_the_same_answers() -> None:
    by_chunk, by_one = plant(), plant()
    for request, _ in REQUESTS:
        frame = struct.pack(">HHHB", 1, 0, len(request.encode()) + 1, 1) + request.encode()
        size, answer, _, _ = by_chunk.answer_chunk(frame, 0, 1)
        in_chunk = answer[7:] if size else by_chunk.answer(request.encode())
        assert in_chunk == by_one.answer(request.encode())
        assert contents(by_chunk) == contents(by_one)


def test_requests_without_a_rule_are_answered_in_c() -> None:
    device = plant()
    for request, in_c in (
        (pdu.ReadHoldingRegisters(0, 6), True),
        (pdu.WriteRegister(5, 1), True),
        (pdu.WriteRegister(0, 60), False),
        (pdu.ReadHoldingRegisters(5, 2), False),
    ):
        frame = struct.pack(">HHHB", 1, 0, len(request.encode()) + 1, 1) + request.encode()
        assert bool(device.answer_chunk(frame, 0, 1)[0]) is in_c


def test_rules_come_before_hooks() -> None:
    log: list[Access] = []
    device = Device.of_map(MAP, {"setpoint": 20}, before_write=log.append, before_read=log.append)
    for request in (b"\6\0\0\1\x2d", b"\6\0\4\0\0", b"\3\0\6\0\1", b"\6\0\x63\0\0"):
        assert device.answer(request)[0] & 0x80
    assert log == []
    assert device.answer(b"\6\0\0\0\xc9") == b"\6\0\0\0\xc9"
    assert len(log) == 1


def test_authorization_comes_before_rules() -> None:
    device = Device.of_map(MAP, authorize=Rules({"Viewer": Allow(read="all")}))
    who = Caller(1, "", role="Viewer")
    assert device.answer(b"\6\0\0\xff\xff", who) == b"\x86\1"
    assert device.answer(b"\6\0\4\0\0", who) == b"\x86\1"
    assert device.answer(b"\3\0\6\0\1", who) == b"\x83\2"


def test_rules_hold_for_broadcasts() -> None:
    device = plant()
    assert device.answer(b"\6\0\0\xff\xff", Caller(0, is_broadcast=True)) == b""
    assert device["setpoint"] == 20


def test_cells_of_several_points() -> None:
    """A client that may read or write one of the points may do so with its cells."""
    device = Device.of_map(
        RegisterMap(
            [
                Point("told", "holding_registers", 0, 4, access="read"),
                Point("asked", "holding_registers", 2, 2, access="write"),
                Point("limit", "holding_registers", 3, 1, minimum=10, access="write"),
                Point("hidden", "holding_registers", 4, 2, access="write"),
            ]
        )
    )
    assert device.answer(b"\3\0\0\0\4")[0] == 3
    assert device.answer(b"\3\0\3\0\2") == b"\x83\2"
    assert device.answer(b"\6\0\1\0\1") == b"\x86\2"
    assert device.answer(b"\6\0\2\0\1")[0] == 6
    assert device.answer(b"\6\0\3\0\x09") == b"\x86\3"
    assert device.answer(b"\x10\0\2\0\2\4\0\1\0\x0a")[0] == 0x10
    assert device["told"] == [0, 0, 1, 10]


def test_bounds_of_a_list_hold_for_each_value() -> None:
    levels = RegisterMap([Point("levels", "holding_registers", 0, 4, maximum=9)])
    device = Device.of_map(levels, {"levels": [1, 2, 3, 4]})
    assert device.answer(b"\x10\0\1\0\2\4\0\x09\0\x0a") == b"\x90\3"
    assert device.answer(b"\x10\0\1\0\2\4\0\x09\0\x08")[0] == 0x10
    assert device["levels"] == [1, 9, 8, 4]


def test_an_access_meets_every_point_that_overlaps_it() -> None:
    """Every point that an access touches is found, wherever the longer ones begin."""
    points = [Point("all", "holding_registers", 0, 300, access="read")]
    points += [Point(f"r{at}", "holding_registers", at, maximum=at) for at in range(300)]
    accesses: list[Access] = []
    device = Device.of_map(RegisterMap(points), before_write=accesses.append)
    for at in range(0, 300, 37):
        assert device.answer(pdu.WriteRegister(at, at + 1).encode()) == b"\x86\3"
        assert device.answer(pdu.WriteRegister(at, at).encode())[0] == 6
        assert set(accesses[-1].names) == {"all", f"r{at}"}


def test_a_point_without_a_value_of_its_type_can_still_be_mended() -> None:
    digits = RegisterMap([Point("digits", "holding_registers", 0, type="bcd16", maximum=50)])
    device = Device.of_map(digits)
    device.mapping.holding_registers[0] = 0xFFFF
    assert device["digits"] is None
    assert device.answer(b"\6\0\0\0\x0a") == b"\x86\3"
    assert device.answer(b"\6\0\0\0\x50")[0] == 6
    assert device["digits"] == 50


def test_programs_are_not_bound_by_the_rules_for_clients() -> None:
    device = Device(Mapping(holding_registers=20, coils=3, input_registers=1), points=MAP)
    device["energy"] = 9
    device.mapping.holding_registers[0] = 999
    assert device["energy"] == 9
    assert device.answer(b"\6\0\3\0\1") == b"\x86\2"
