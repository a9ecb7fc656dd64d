"""The command write: items, ranges and names, and what is sent for them."""

from datetime import UTC, datetime
from pathlib import Path

from libmodbus_py import Access, Device, IllegalDataAddress, Mapping, Server, load_map
from tests.support.cases import each, each_case
from tests.support.commands import on_terminal, run
from tests.support.peers import FakeServer, mbap


def frames(err: str) -> list[str]:
    """The PDUs that -v shows as sent."""
    return [line.split("  ")[-1].strip()[21:] for line in err.splitlines() if " > " in line]


@each_case(
    ("words", "pdus"),
    [
        # Sections 6.5, 6.6, 6.11, 6.12, 6.16 and 6.17.
        ("holding 1 3", ["06 00 01 00 03"]),
        ("holding 1 3 --multiple", ["10 00 01 00 01 02 00 03"]),
        ("holding 1 3 4 --write-function single", ["06 00 01 00 03", "06 00 02 00 04"]),
        ("coils 7 on --write-function multiple", ["0f 00 07 00 01 01 01"]),
        ("coils 7 on", ["05 00 07 ff 00"]),
        ("coils 7 on --multiple", ["0f 00 07 00 01 01 01"]),
        ("holding 4 --mask 0xF2 0x25", ["16 00 04 00 f2 00 25"]),
        ("holding 14 255 255 255 --and-read 3 6",
         ["17 00 03 00 06 00 0e 00 03 06 00 ff 00 ff 00 ff"]),
        ("holding 1 2 3 coils 0 1 0 file:4 1 6",
         ["10 00 01 00 02 04 00 02 00 03", "0f 00 00 00 02 01 01",
          "15 09 06 00 04 00 01 00 01 00 06"]),
        ("--count-from-1 holding 1 3", ["06 00 00 00 03"]),
        ("40002 -1", ["06 00 01 ff ff"]),
        ("40002=-1 hr 3=4 40005=6", ["06 00 01 ff ff", "06 00 03 00 04", "06 00 04 00 06"]),
        ("hr 3:float32=0.5 coils 7=on", ["10 00 03 00 02 04 3f 00 00 00", "05 00 07 ff 00"]),
        # The masks of section 6.16: all bits but one, and that one.
        ("hr 4.3=on", ["16 00 04 ff f7 00 08"]),
        ("hr 4.15 off 40005.0=1 hr 5=7",
         ["16 00 04 7f ff 00 00", "16 00 04 ff fe 00 01", "06 00 05 00 07"]),
        ("hr 3-4 5 6", ["10 00 03 00 02 04 00 05 00 06"]),
    ],
)  # fmt: skip
def test_values_are_written_in_the_right_bytes(url: str, words: str, pdus: list[str]) -> None:
    result = run("write", url, *words.split(), "-v")
    assert result.code == 0, result.err
    assert frames(result.err) == pdus
    dry = run("write", url, *words.split(), "--dry-run")
    requests = [line.split("  ")[0][2 + 21 :] for line in dry.out.splitlines()]
    assert requests == pdus


def test_names_are_written_scaled_and_checked(url: str, meter: str, mapping: Mapping) -> None:
    result = run("write", url, "--map", meter, "setpoint", "21.5", "pump", "on", "label", "xyz")
    assert (result.code, result.out, result.err) == (0, "", "")
    assert mapping.holding_registers[30] == 215
    assert mapping.coils[3] == 1
    assert run("read", url, "--map", meter, "setpoint").out == "setpoint  21.5 C\n"
    for words, message in (
        ("setpoint 99", "setpoint: value must be in 0..90, not 99"),
        ("setpoint warm", "setpoint: "),
        ("voltage 3", "voltage cannot be written"),
        ("pump 2", "pump: value must be one of 0, 1"),
        ("setpoint 0x1F", "setpoint: value must be a number, not '0x1F'"),
        ("setpoint", "setpoint needs 1 value after its name, not 0"),
        ("setpoint 1 2", "setpoint needs 1 value after its name, not 2"),
        ("setpoint 1 --mask 1 2", "not a name"),
    ):
        result = run("write", url, "--map", meter, *words.split())
        assert (result.code, result.out) == (2, ""), words
        assert message in result.err
        assert result.err.count("\n") == 1
    assert mapping.holding_registers[30] == 215


@each_case(
    ("words", "line"),
    [
        ("hr 0 5", "hr 0: wrote 5"),
        ("40001=5 --verify", "40001: wrote 5, read back 5"),
        ("hr 0 3.5 --type float32 --verify", "hr 0: wrote 3.5, read back 3.5"),
        ("co 1 on off --verify", "co 1: wrote on off, read back 1 0"),
        ("hr 0 --mask 0 9 --verify", "hr 0: wrote the bits of the mask, read back 9"),
        ("setpoint=21.5 --verify --map", "setpoint: wrote 21.5, read back 21.5 C"),
    ],
)
def test_a_terminal_says_what_was_written(url: str, meter: str, words: str, line: str) -> None:
    typed = words.split() + [meter] * words.endswith("--map")
    with on_terminal("write", url, *typed) as terminal:
        assert terminal.read_to_end() == f"{line}\r\n"
    assert run("write", url, *typed) == (0, "", "")


def test_names_and_addresses_are_written_in_the_order_typed(url: str, meter: str) -> None:
    words = "setpoint 1 holding 0 7 pump on setpoint 2"
    result = run("write", url, "--map", meter, *words.split(), "-v")
    assert result.code == 0, result.err
    assert frames(result.err) == [
        "06 00 1e 00 0a",
        "06 00 00 00 07",
        "05 00 03 ff 00",
        "06 00 1e 00 14",
    ]


TYPED_MAP = """\
name,table,address,type,states,bits,bit,time zone
state,holding,0,,0 = off; 1 = on,,,
flags,holding,1,,,0 = door; 4..7 = mode,,
clock,holding,2,unix32,,,,
local,holding,4,date48,,,,Europe/Berlin
flag,holding,7,,,,3,
"""

NOON = datetime(2026, 7, 1, 12, tzinfo=UTC)

# Name, text, value, or the error with which the command refuses it.
TYPED = [
    ("state", "on", "on"),
    ("state", "0", "off"),
    ("flags", "door=1, mode=5", {"door": True, "mode": 5}),
    ("flags", '{"door": false, "mode": 7}', {"door": False, "mode": 7}),
    ("clock", "2026-07-01T14:00:00+02:00", NOON),
    ("local", "2026-07-01T12:00:00Z", NOON),
    ("flag", "1", True),
    ("state", "up", ValueError("value must")),
    ("flags", '{"door": 1, "door": 0}', ValueError("value.door: occurs twice")),
    ("clock", "2026-07-01T12:00:00", ValueError("value must")),
]


def test_every_kind_of_value_can_be_typed(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text(TYPED_MAP)
    device = Device.of_map(load_map(path))
    with Server(device).background("tcp://127.0.0.1:0") as serving:
        for check, (name, text, value) in each(TYPED):
            before = device[name]
            result = run("write", serving.urls[0], "--map", str(path), name, text)
            refused = str(value) if isinstance(value, ValueError) else None
            with check:
                assert (result.code == 0) is (refused is None), result.err
                assert device[name] == (before if refused else value)
                assert (refused or "") in result.err


class Stubborn:
    """A device that acknowledges writes, and keeps its registers and coils: all are 7 or on."""

    def __call__(self, request: bytes) -> list[bytes]:
        function, count = request[7], int.from_bytes(request[10:12], "big")
        if function == 3:
            data = bytes([0, 7]) * count
        elif function == 1:
            data = bytes([(1 << count) - 1])
        else:
            return [mbap(request, request[7:12] if function in (15, 16) else request[7:])]
        return [mbap(request, bytes([function, len(data)]) + data)]


@each_case(
    ("words", "lines"),
    [
        ("hr 5 7", []),
        ("hr 5 8", ["hr 5: wrote 8, reads 7"]),
        ("hr 5 7 8 9", ["hr 6: wrote 8, reads 7", "hr 7: wrote 9, reads 7"]),
        ("co 3 off", ["co 3: wrote 0, reads 1"]),
        ("co 3 on off", ["co 4: wrote 0, reads 1"]),
        ("hr 5 8 co 3 off", ["hr 5: wrote 8, reads 7", "co 3: wrote 0, reads 1"]),
        ("hr 5 --mask 0xFFF0 0x0007", []),
        ("hr 5 --mask 0xFFF0 0x0006", ["hr 5: wrote 6, reads 7"]),
        ("hr 6 8 --count-from-1", ["hr 6: wrote 8, reads 7"]),
    ],
)
def test_verify_names_the_values_that_differ(words: str, lines: list[str]) -> None:
    with FakeServer(Stubborn()) as server:
        result = run("write", f"127.0.0.1:{server.port}", *words.split(), "--verify")
    assert result.code == (1 if lines else 0)
    assert result.err.splitlines() == [f"libmodbus-py: {line}" for line in lines]


def test_a_cell_that_cannot_be_read_fails() -> None:
    device = Device(Mapping(holding_registers=9), before_read=refusing)
    with Server(device).background("tcp://127.0.0.1:0") as running:
        result = run("write", running.urls[0], "hr", 0, 1, "--verify")
    assert result.code == 1
    assert "ReadHoldingRegisters(address=0, count=1): illegal" in result.err


def refusing(access: Access) -> None:
    raise IllegalDataAddress


def test_an_error_of_a_missing_function_names_another_function() -> None:
    with FakeServer(lambda request: [mbap(request, bytes([request[7] | 0x80, 1]))]) as device:
        result = run("write", device.url, "holding", "1", "3")
        assert "illegal function (exception 1); --multiple writes with function 16" in result.err
        result = run("write", device.url, "coils", "1", "on", "off")
        assert "--write-function single writes with function 5" in result.err
