"""Which function writes values, and layouts of a program's own."""

from typing import Any, ClassVar

import pytest

from libmodbus_py import (
    FrameError,
    IllegalDataAddress,
    IllegalFunction,
    ModbusTimeoutError,
    Point,
    RegisterMap,
    pdu,
)
from tests.support.cases import each_case
from tests.support.clients import Connect, World
from tests.support.contexts import context_at
from tests.support.driver import ascii_frame, rtu
from tests.support.peers import OnRequest, Write, mbap, peer_at

SINGLE, MULTIPLE = (5, 6), (15, 16)

POINTS = RegisterMap(
    [
        Point("run", "coils", 0),
        Point("setpoint", "holding_registers", 3, scale=0.1),
        Point("energy", "holding_registers", 4, type="uint32"),
        Point("mode", "holding_registers", 9, bit="0..3"),
    ]
)


def knowing(*functions: int) -> OnRequest:
    """Return a device that executes these functions, and refuses others as small devices do."""

    def on_request(request: bytes, write: Write) -> None:
        function = request[7]
        if function == 3:
            write(mbap(request, b"\3\2\0\x50"))
        elif function in functions:
            write(mbap(request, request[7:12]))
        else:
            write(mbap(request, bytes([function | 0x80, 1])))

    return on_request


def sent(peer: Any) -> list[str]:
    """Return the PDUs of the requests that were not refused, without reads."""
    carried = [request for request in peer.requests if request[7] not in (3, 22)]
    return [request[7:].hex() for request in carried]


RUN, VALUES = {"run": True}, {"setpoint": 0.7, "energy": 0x10002}

# The option, the functions of the device, the values, and the requests.
WRITES: list[tuple[str, tuple[int, ...], dict[str, Any], list[str]]] = [
    ("single", SINGLE, RUN, ["050000ff00"]),
    ("single", SINGLE, VALUES, ["0600030007", "0600040001", "0600050002"]),
    ("multiple", MULTIPLE, RUN, ["0f000000010101"]),
    ("multiple", MULTIPLE, {"setpoint": 0.7}, ["10000300010200 07".replace(" ", "")]),
    ("multiple", MULTIPLE, VALUES, ["100003000306000700010002"]),
    ("auto", SINGLE, {"setpoint": 0.7}, ["0600030007"]),
    ("auto", MULTIPLE, {"setpoint": 0.7}, ["0600030007", "1000030001020007"]),
    ("auto", MULTIPLE, RUN, ["050000ff00", "0f000000010101"]),
    ("auto", MULTIPLE, VALUES, ["100003000306000700010002"]),
    ("auto", SINGLE, {"mode": 2}, ["0600090052"]),
    ("auto", MULTIPLE, {"mode": 2}, ["0600090052", "1000090001020052"]),
    ("multiple", MULTIPLE, {"mode": 2}, ["1000090001020052"]),
]


@each_case(("option", "functions", "values", "requests"), WRITES)
def test_a_map_is_written_with_the_functions_that_the_device_has(
    world: World, option: str, functions: tuple[int, ...], values: Any, requests: list[str]
) -> None:
    peer = world.peer("tcp", knowing(*functions))
    with world.connect(peer.url, write_function=option) as plc:
        plc.write_map(POINTS, values)
    assert sent(peer) == requests


@each_case(
    ("option", "functions", "requests"),
    [
        ("auto", MULTIPLE, ["1000030002043f800000"]),
        ("multiple", MULTIPLE, ["1000030002043f800000"]),
        ("single", SINGLE, ["0600033f80", "0600040000"]),
    ],
)
def test_values_are_written_by_the_chosen_functions(world: World, option, functions, requests):
    peer = world.peer("tcp", knowing(*functions))
    with world.connect(f"{peer.url}?write_function={option}") as plc:
        plc.write_value("holding_registers", 3, 1.0, "float32")
        plc.write_values("holding_registers", 3, [1.0], "float32")
        with pytest.raises(ValueError, match="address"):
            plc.write_value("holding_registers", 65535, 1.0, "float32")
    assert sent(peer) == 2 * requests


def test_a_write_refused_with_both_functions_raises_the_refusal(world: World) -> None:
    with (
        world.client_of("tcp", knowing()) as plc,
        pytest.raises(IllegalFunction, match="Registers"),
    ):
        plc.write_map(POINTS, {"setpoint": 0.7})
    for option in ("single", "multiple"):
        peer = world.peer("tcp", knowing())
        with world.connect(peer.url, write_function=option) as plc:
            with pytest.raises(IllegalFunction):
                plc.write_map(POINTS, VALUES)
            assert len(peer.requests) == 1


def test_a_unit_and_a_point_have_their_own_write_functions(world: World) -> None:
    peer = world.peer("tcp", knowing(*SINGLE, *MULTIPLE))
    own = RegisterMap(
        [
            Point("a", "holding_registers", 0, write_function="single"),
            Point("b", "holding_registers", 1),
            Point("c", "holding_registers", 2, write_function="multiple"),
        ]
    )
    with world.connect(peer.url) as plc:
        plc.for_unit(2, write_function="multiple").write_map(POINTS, {"setpoint": 0.7})
        plc.write_map(own, {"a": 1, "b": 2, "c": 3})
        with pytest.raises(ValueError, match="write_function must be one of auto, single, mul"):
            plc.for_unit(2, write_function="many")
    assert sent(peer) == ["1000030001020007", "0600000001", "0600010002", "1000020001020003"]
    with pytest.raises(ValueError, match="write_function must be one of single, multiple, not 16"):
        Point("a", "holding_registers", 0, write_function=16)  # type: ignore[arg-type]


# As a frequency inverter answers: the count of bytes has 16 bits (pymodbus#1542).
ANSWER = "03 0002 1781"
REQUEST = bytes.fromhex("7002 0001")
USUAL, USUAL_ANSWER = "03 0005 0001", "03 02 0007"
REFUSED, REFUSAL = "03 0009 0001", "83 02"


class WideCount(pdu.Request[bytes]):
    """Function 3, whose answers have a count of two bytes; the program does not register it."""

    function: ClassVar[int] = 3
    request_length = pdu.fixed(5)
    response_length: ClassVar[Any] = staticmethod(
        lambda head: 3 + int.from_bytes(head[1:3], "big") if len(head) > 2 else None
    )

    def encode(self) -> bytes:
        return b"\x03" + REQUEST

    def _decode_response(self, data: bytes) -> bytes:
        return data[3:]


def device(scheme: str, pieces: int = 1) -> Any:
    def on_request(request: bytes, write: Write) -> None:
        text = bytes.fromhex(request[1:-4].decode()) if request.startswith(b":") else request
        usual, other = bytes.fromhex(USUAL), bytes.fromhex(REFUSED)
        body = USUAL_ANSWER if usual in text else REFUSAL if other in text else ANSWER
        if scheme == "tcp":
            frame = mbap(request, bytes.fromhex(body))
        else:
            frame = (ascii_frame if scheme.startswith("ascii") else rtu)("01" + body)
        size = -(-len(frame) // pieces)
        for at in range(0, len(frame), size):
            write(frame[at : at + size])

    return peer_at(scheme, on_request)


SCHEMES = ["rtu", "rtu+tcp", "rtu+udp", "ascii", "ascii+tcp", "tcp"]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("pieces", [1, 3])
def test_registered_layouts_are_decoded(connect: Connect, scheme: str, pieces: int) -> None:
    pieces = 1 if scheme == "rtu+udp" else pieces
    with device(scheme, pieces) as peer, connect(peer.url, unit=1, timeout=2) as client:
        check(client)


@pytest.mark.parametrize("scheme", ["rtu", "tcp"])
def test_contexts_decode_answers_in_a_registered_layout(scheme: str) -> None:
    with device(scheme) as peer, context_at(peer.url, unit=1, timeout=2) as context:
        check(context)


def check(client: Any) -> None:
    """The usual layout before, between and behind."""
    for _ in range(2):
        assert client.read_holding_registers(5, 1) == [7]
        assert client.execute(pdu.RawRequest(3, REQUEST)) == bytes.fromhex("0002 1781")
        assert client.execute(pdu.RawRequest(3, bytes.fromhex(USUAL)[1:])) == b"\2\0\7"
        assert client.execute(WideCount()) == bytes.fromhex("1781")
        with pytest.raises(IllegalDataAddress):
            client.execute(pdu.RawRequest(3, bytes.fromhex(REFUSED)[1:]))


def test_a_damaged_answer_to_a_raw_request_is_no_result(connect: Connect) -> None:
    frame = rtu("01" + ANSWER)[:-1] + b"\0"
    with (
        peer_at("rtu", lambda request, write: write(frame)) as peer,
        connect(peer.url, unit=1, timeout=0.2) as client,
        pytest.raises((ModbusTimeoutError, FrameError)),
    ):
        client.execute(pdu.RawRequest(3, REQUEST))
