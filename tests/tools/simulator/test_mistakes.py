"""
Device files that are wrong, and what is said of them: both are in `golden/mistakes.txt`.
"""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.tools.simulator.device_file import DeviceFileError, load, parse
from tests.support.golden import Refused

METER = """name,table,address,type,scale,unit,access
voltage,input,0,uint16,0.1,V,read
power,input,2,int32,,W,read
status,holding,5,uint16,,,read
status high,holding,5,bits16,,,read_write
pump,coil,4,,,,read_write
"""

MISTAKES = Path(__file__).with_name("golden") / "mistakes.txt"
"""A file as Python writes it, and in the next line what is said of it; then an empty line."""


def test_a_wrong_file_is_told_what_is_wrong(tmp_path: Path, refused: Refused) -> None:
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
def test_whatever_a_file_says_nothing_but_its_error_is_raised(key: str, content: object) -> None:
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
