"""Device files: the examples, and mistakes."""

import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import fields
from inspect import signature
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Client, IllegalDataAddress, Point, Server, pdu
from libmodbus_py.tools.faults.fault import KINDS, PLACES, Fault
from libmodbus_py.tools.simulator import example_files
from libmodbus_py.tools.simulator.device_file import (
    FIFO,
    FILE,
    SERVER_ID,
    UNIT,
    DeviceFileError,
    load,
    parse,
)
from libmodbus_py.tools.simulator.movements import BEHAVIOURS
from libmodbus_py.tools.simulator.points import CONTENTS, DEFAULTS
from tests.support.golden import Refused

PLANT = Path(__file__).parents[3] / "examples" / "plant.toml"


@pytest.fixture(scope="module")
def plant() -> Iterator[str]:
    plant = load(PLANT)
    with Server(plant.devices, faults=plant.faults).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_the_example_behaves_as_its_comments_say(plant: str) -> None:
    with Client(plant, unit=1, timeout=5) as boiler:
        assert boiler.read_exception_status() == 0x55
        assert boiler.report_server_id() == pdu.ServerId(b"\x2a", True, b"boiler 1")
        assert boiler.read_device_identification("extended").objects == {
            0: b"Example Ltd",
            1: b"BOILER",
            2: b"1.2",
            128: b"commissioned 2024",
        }
        assert boiler.read_coils(0, 4) == [True, False, True, True]
        assert boiler.read_coils(10, 16) == [True] * 16
        boiler.write_coil(30, True)
        assert boiler.read_holding_registers(100, 3) == [555, 0, 100]
        assert boiler.read_holding_registers(200, 100) == [0] * 100
        assert boiler.read_values("holding_registers", 300, "int16") == [-40]
        read = boiler.read_values("holding_registers", 310, "float32", 2, order="CDAB")
        assert read == [21.5, -3.25]
        text = {"encoding": "latin-1", "padding": " "}
        assert boiler.read_values("holding_registers", 320, "string:12", **text) == ["Kessel Süd"]
        assert boiler.read_input_registers(7, 1) == [215]
        assert boiler.read_file_records([(4, 0, 100)]) == [[0xFFFF] * 100]
        assert boiler.read_file_records([(3, 9, 2), (3, 12, 1)]) == [[0x33CD, 0x0040], [7]]
        assert boiler.read_fifo_queue(1246) == [440, 4740]


def test_the_example_refuses_requests_as_its_comments_say(plant: str) -> None:
    with Client(plant, unit=1, timeout=5) as boiler:
        refused: list[Callable[[], object]] = [
            lambda: boiler.read_coils(4, 1),
            lambda: boiler.read_coils(0, 5),
            lambda: boiler.read_coils(30, 1),
            lambda: boiler.write_register(300, 0),
            lambda: boiler.read_holding_registers(103, 1),
            lambda: boiler.read_file_records([(3, 11, 1)]),
            lambda: boiler.write_file_records([(3, 12, [1])]),
        ]
        for ask in refused:
            with pytest.raises(IllegalDataAddress):
                ask()


OF_FAULTS = Fault.__dataclass_fields__
OF_BEHAVIOURS = {key for make in BEHAVIOURS.values() for key in signature(make).parameters}
OF_BEHAVIOURS -= {"point", "others"}


def test_the_examples_have_every_key() -> None:
    text = PLANT.read_text() + Path(example_files.path_of("meter")).read_text()
    keys = set(re.findall(r"^(\w+) =|[{,] (\w+) =", text, re.MULTILINE))
    present = {one or other for one, other in keys}
    present |= set(re.findall(r"^\[+(?:unit\.)?(\w+)[].]", text, re.MULTILINE))
    # What registers say is in register maps; `test_every_key_of_points` tries those keys here.
    meaning = [field.name for field in fields(Point) if field.init]
    present.update(meaning[meaning.index("missing") :])
    for options in (UNIT, SERVER_ID, FIFO, *CONTENTS.values(), OF_FAULTS, OF_BEHAVIOURS):
        assert set(options) - {"columns", "list"} <= present  # which the lists of vendors need
    for kind in KINDS:
        assert f'kind = "{kind}"' in text


def test_the_page_about_the_simulator_explains_every_key() -> None:
    text = (PLANT.parents[1] / "docs" / "how-to" / "simulator.md").read_text()
    faults = (PLANT.parents[1] / "docs" / "api" / "servers.md").read_text()
    text = text[text.index("## All keys") :] + faults[faults.index("## Fault\n") :]
    explained = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`]+`|\"\w+\"", text))))
    keys = [FILE, UNIT, SERVER_ID, FIFO, DEFAULTS, *CONTENTS.values(), KINDS, PLACES]
    for options in (*keys, OF_FAULTS, OF_BEHAVIOURS):
        assert set(options) <= explained


METER = """name,table,address,type,scale,unit,access
voltage,input,0,uint16,0.1,V,read
power,input,2,int32,,W,read
status,holding,5,uint16,,,read
status high,holding,5,bits16,,,read_write
pump,coil,4,,,,read_write
"""

MISTAKES = Path(__file__).with_name("golden") / "mistakes.txt"
"""A file as Python writes it, and in the next line what is said of it; then an empty line."""


def test_errors_of_files_name_the_mistake(tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "meter.csv").write_text(METER)
    (tmp_path / "bad.csv").write_text("name,table,address\na,coilz,0\n")

    def load_text(text: str) -> None:
        path = tmp_path / "device.toml"
        path.write_text(text, newline="")
        with pytest.raises(DeviceFileError) as caught:
            load(path)
        raise ValueError(str(caught.value).replace(str(tmp_path), "FOLDER"))

    refused("mistakes.txt", load_text)
    assert MISTAKES.read_text().count("\n") > 3 * 150


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceFileError, match=r"^cannot read .*/none.toml: No such file or dir"):
        load(tmp_path / "none.toml")
    with pytest.raises(DeviceFileError, match=r"^cannot read .*: Is a directory$"):
        load(tmp_path)
    with pytest.raises(DeviceFileError, match=r"^unit\[0\].map: "):
        parse("[[unit]]\nmap = '\\u0000.csv'")
    (tmp_path / "latin.toml").write_bytes(b"# \xfc")
    with pytest.raises(DeviceFileError, match=r"latin.toml: byte 2 is not UTF-8; save it as "):
        load(tmp_path / "latin.toml")


scalars = st.none() | st.booleans() | st.integers(-70000, 70000) | st.floats() | st.text(max_size=3)
KEYS = ["id", "address", "count", "value", "values", "type", "order", "counter", "sine", "copy"]
KEYS += ["low", "high", "period", "table", "scale", "kind", "every", "number", "record", "x y"]
tables = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4)
    ),
    max_leaves=8,
)


@given(key=st.sampled_from(["id", "coils", "holding_registers", "file", "fault"]), content=tables)
def test_any_text_raises_only_a_file_error(key: str, content: object) -> None:
    text = f"[[unit]]\n{key} = {_toml(content)}"
    message = ""
    try:
        parse(text)
    except DeviceFileError as error:
        message = str(error)
    assert "\n" not in message


def _toml(value: object) -> str:
    if isinstance(value, dict):
        pairs = ", ".join(f"{json.dumps(key)} = {_toml(item)}" for key, item in value.items())
        return f"{{ {pairs} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return '"-"' if value is None else json.dumps(value)
