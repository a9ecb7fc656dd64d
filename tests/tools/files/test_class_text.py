"""Python classes for register maps: what they have, and that no text of a map becomes a program."""

import ast
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from libmodbus_py import Client, Device, Point, RegisterMap, Server, load_map
from libmodbus_py.maps.point import attribute_names
from libmodbus_py.tools.files.map_texts import class_name, class_text
from tests.support.cases import each_case
from tests.support.programs import run_to_end

TYPING = Path(__file__).parents[2] / "typing"


def names_in(map: RegisterMap, stem: str = "meter") -> dict[str, Any]:
    """Return the names of the module that a class is in."""
    space: dict[str, Any] = {"__name__": "made"}
    exec(compile(class_text(map, stem), "made.py", "exec"), space)
    return space


def test_the_generated_class_is_the_recorded_one() -> None:
    assert class_text(load_map(TYPING / "meter.csv"), "meter") == (TYPING / "meter.py").read_text()


def test_values_are_read_and_written_with_a_generated_class() -> None:
    map = load_map(TYPING / "meter.csv")
    device = Device.of_map(map, {"voltage": 230.5, "energy total": 7, "serial number": "A1"})
    with Server(device).background("tcp://127.0.0.1:0") as running, Client(running.urls[0]) as plc:
        meter = names_in(map)["Meter"](plc)
        with pytest.raises(AttributeError, match=r"voltage has not been read: call read\(\)"):
            print(meter.voltage)
        meter.read()
        assert (meter.voltage, meter.energy_total, meter.run) == (230.5, 7, False)
        assert meter["energy total"] == 7
        meter.write(setpoint=21.5, run=True, reset=True)
        assert (meter.run, device["setpoint"], device["reset"]) == (False, 21.5, True)
        meter.read("run")
        assert (meter.run, meter.setpoint) == (True, 0)
        with pytest.raises(AttributeError, match="'sepoint'; did you mean setpoint"):
            meter.write(sepoint=3)
        with pytest.raises(ValueError, match=r"setpoint: value must be in 5\.\.30"):
            meter.write(setpoint=99)
        with pytest.raises(AttributeError):
            meter.setpoint = 3
        with pytest.raises(AttributeError):
            print(meter.reset)  # it cannot be read
    assert "230.5" in repr(meter)


@each_case("stem", ["MAP", "point", "ClientT"])
def test_a_class_has_a_name_that_the_file_does_not_use(stem: str) -> None:
    map = RegisterMap([Point("a", "coils", 0)])
    device = Device.of_map(map, {"a": True})
    with Server(device).background("tcp://127.0.0.1:0") as running, Client(running.urls[0]) as plc:
        meter = names_in(map, stem)[f"{class_name(stem)}Map"](plc)
        meter.read()
        assert meter.a is True


MEANINGS = [
    (Point("a", "holding_registers", 0), "int"),
    (Point("a", "holding_registers", 0, scale=2, offset=-5), "int"),
    (Point("a", "holding_registers", 0, scale=0.1), "float"),
    (Point("a", "holding_registers", 0, offset=0.5), "float"),
    (Point("a", "holding_registers", 0, type="float32"), "float"),
    (Point("a", "holding_registers", 0, type="string:4"), "str"),
    (Point("a", "holding_registers", 0, type="bits16"), "list[bool]"),
    (Point("a", "holding_registers", 0, type="bits16", count=2), "list[list[bool]]"),
    (Point("a", "coils", 0), "bool"),
    (Point("a", "coils", 0, count=3), "list[bool]"),
    (Point("a", "holding_registers", 0, type="unix32"), "datetime | None"),
    (Point("a", "holding_registers", 0, missing=0xFFFF), "int | None"),
    (Point("a", "holding_registers", 0, missing=[1, 2], scale=0.1), "float | None"),
    (Point("a", "holding_registers", 0, plausible_maximum=9), "int | None"),
    (Point("a", "holding_registers", 0, states={0: "off", 1: 'say "on"'}), "str | int"),
    (Point("a", "holding_registers", 0, bits={0: "door", "4..7": "mode"}), "dict[str, int]"),
    (Point("a", "holding_registers", 0, bit=3), "bool"),
    (Point("a", "holding_registers", 0, bit="4..7"), "int"),
    (Point("a", "holding_registers", 0, byte="high"), "int"),
]


@each_case(("point", "kind"), MEANINGS)
def test_attributes_have_the_types_of_their_points(point: Point, kind: str) -> None:
    text = class_text(RegisterMap([point]), "meter")
    assert f"    def a(self) -> {kind}:\n" in text
    assert list(names_in(RegisterMap([point]))["MAP"].values()) == [point]


def test_an_optional_value_may_be_none_and_a_required_one_raises() -> None:
    map = RegisterMap(
        [
            Point("a", "holding_registers", 0, missing=0xFFFF),
            Point("b", "holding_registers", 1, type="float32"),
        ]
    )
    device = Device.of_map(map)
    device.mapping.holding_registers[0:3] = [0xFFFF, 0x7FC0, 0]
    with Server(device).background("tcp://127.0.0.1:0") as running, Client(running.urls[0]) as plc:
        meter = names_in(map)["Meter"](plc)
        meter.read()
        assert meter.a is None
        with pytest.raises(ValueError, match="b has no value"):
            print(meter.b)
        assert meter["b"] is None


TEXTS = [
    '"""',
    "'''",
    '"""\nimport os\nos.abort()\n"""',
    "\\",
    "\\\\",
    '\\"',
    '"',
    'ends with a quote"',
    "ends with a backslash\\",
    'a \\""" b',
    "{} {0} %s {__import__('os').abort()}",
    "\\N{BULLET} \\x00 \\u0000 \\",
    "line\nline\n\n\n    line\n\ttab\n",
    "# noqa\n# type: ignore",
    "ä ° µ Ω 温度 🔥",
    '""""""""""',
    " ".join(["word"] * 300),
    "\\" * 300,
]


@each_case("text", TEXTS)
def test_descriptions_remain_plain_text(text: str) -> None:
    check_texts(RegisterMap([Point("a", "coils", 0, description=text)]))


PRINTABLE = st.characters(exclude_categories=["C", "Z"])


@given(st.text(PRINTABLE, min_size=1, max_size=20), st.text(PRINTABLE | st.just("\n"), max_size=80))
def test_any_text_is_written_as_a_plain_text(name: str, description: str) -> None:
    check_texts(RegisterMap([Point(name, "holding_registers", 0, description=description)]))


@given(st.text(min_size=0, max_size=20))
@example('x"""\nimport os #')
@example("a\\")
def test_any_name_of_a_file_gives_a_class(stem: str) -> None:
    if any(0xD800 <= ord(entry) <= 0xDFFF for entry in stem):
        return  # no file has such a name
    text = class_text(RegisterMap([Point("a", "coils", 0)]), stem)
    classes = [node.name for node in ast.parse(text).body if isinstance(node, ast.ClassDef)]
    assert len(classes) == 3
    assert class_name(stem).isidentifier()


def check_texts(map: RegisterMap) -> None:
    """The file has the statements that it has for plain texts, and the points are the same."""
    text = class_text(map, "meter")
    plain = RegisterMap([Point(f"p{at}", "coils", at) for at in range(len(map))])
    statements, kinds = (
        [type(node).__name__ for node in ast.parse(entry).body]
        for entry in (text, class_text(plain, "meter"))
    )
    assert statements == kinds
    assert list(names_in(map)["MAP"].values()) == list(map.values())


@each_case(
    ("names", "attributes"),
    [
        (["voltage", "L1", "température"], ["voltage", "L1", "température"]),
        (["Voltage L1", "  "[:0] + "°C", "a--b"], ["Voltage_L1", "C", "a_b"]),
        (["1st", "3", "-"], ["point_1st", "point_3", "point"]),
        (["class", "read", "self", "float", "map"], ["class_", "read_", "self_", "float_", "map_"]),
        (["a b", "a_b", "a-b"], ["a_b_2", "a_b", "a_b_3"]),
        (["_private", "__init__", "__class__"], ["private", "init", "class_"]),
        (["ﬁeld", "field"], ["field_2", "field"]),
        (["None", "True", "lambda"], ["None_", "True_", "lambda_"]),
        (["", "!", "?"], ["point", "point_2", "point_3"]),
        (["a", "a_2", "a "], ["a", "a_2", "a_3"]),
    ],
)
def test_names_of_points_become_attributes(names: list[str], attributes: list[str]) -> None:
    assert list(attribute_names(names).values()) == attributes


@given(st.lists(st.text(max_size=8), unique=True, max_size=12))
def test_attributes_are_identifiers_and_differ(names: list[str]) -> None:
    attributes = attribute_names(names)
    assert list(attributes) == names
    assert len(set(attributes.values())) == len(names)
    for attribute in attributes.values():
        assert attribute.isidentifier()
        assert ast.parse(f"x.{attribute}")
        assert not attribute.startswith("_")


NASTY = RegisterMap(
    [
        Point(name, "holding_registers", at)
        for at, name in enumerate(
            (
                *("float", "property", "Any", "Meter", "MeterName", "MAP", "overload", "keys"),
                *("items", "get", "self", "values", "attributes", "Client", "super", "value"),
                *("class", "a b", "a-b", "ClientT", "str", "int", "datetime", "Literal", "copy"),
            )
        )
    ]
    + [
        Point("levels", "holding_registers", 100, 3, type="float32"),
        Point("flags", "holding_registers", 110, type="bits16"),
        Point("texts", "holding_registers", 120, 2, type="string:4"),
        Point("alarms", "coils", 0, 8),
        Point("hidden", "coils", 9, access="write"),
        Point("quotes", "coils", 10, description='say "hello"\nand \\ and """ and ""'),
    ]
)


TOOLS = Path(sys.executable).parent


@pytest.mark.skipif(
    not ((TOOLS / "ruff").exists() and (TOOLS / "mypy").exists()),
    reason="ruff and mypy are installed by ./run lint",
)
def test_mypy_and_pyright_accept_a_map_with_difficult_names(tmp_path: Path) -> None:
    (tmp_path / "meter.py").write_text(class_text(NASTY, "meter"))
    (tmp_path / "none.py").write_text(class_text(RegisterMap([Point("a", "coils", 0)]), "class"))
    mypy = [TOOLS / "mypy", "--strict", "--follow-imports=silent", "--cache-dir", tmp_path / "c"]
    for command in (
        [TOOLS / "ruff", "check", "--isolated", "--no-cache", "."],
        [*mypy, "meter.py", "none.py"],
    ):
        environment = {"PATH": "/usr/bin:/bin", "MYPYPATH": str(TYPING.parents[1])}
        result = run_to_end(*command, seconds=170, cwd=tmp_path, env=environment)
        assert result.returncode == 0, result.stdout + result.stderr
    names_in(NASTY)
