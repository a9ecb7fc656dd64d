"""
Device files that are wrong, and what is said of them: whole in `golden/mistakes.txt`.
"""

from __future__ import annotations

import json
import math
import reprlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.tools.simulator.device_file import DeviceFileError, load, parse
from tests.support.golden import Golden
from tests.tools.simulator.simulated_units import HOLDING

FAULT = "[[unit]]\n[[unit.fault]]\n"
INPUT = "[[unit.input_registers]]\naddress = 0\n"
MAPPED = "[[unit]]\nmap = 'meter.csv'\n"

METER = """name,table,address,type,scale,unit,access
voltage,input,0,uint16,0.1,V,read
power,input,2,int32,,W,read
status,holding,5,uint16,,,read
status high,holding,5,bits16,,,read_write
pump,coil,4,,,,read_write
"""

RANGE = "[[unit]]\n[[unit.holding_registers]]\naddress = 0\nname = 'a'\n"
SECOND = "[[unit.holding_registers]]\naddress = 0\nname = 'b'\n"

TABLES_AND_KEYS = [
    "[[unit]",
    "[[unit]]\nid = 1\nid = 2\n",
    "",
    "unit = []",
    "[unit]",
    "unit = [1]",
    "units = []",
    "'my unit' = []",
    "[[unit]]\nid = 248",
    "[[unit]]\nid = -1",
    "[[unit]]\nid = '1'",
    "[[unit]]\nid = true",
    "[[unit]]\nid = 1\n[[unit]]\nid = 1",
    "[[unit]]\nid = 1\n[[unit]]",
    "[[unit]]\n[[unit]]",
    "[[unit]]\nnames = 'x'",
    "[[unit]]\nexception_status = 256",
    "[[unit]]\nserver_id = 1",
    "[[unit]]\nserver_id = { name = 1 }",
    "[[unit]]\nserver_id = { running = 1 }",
    "[[unit]]\nserver_id = { identifier = '' }",
    "[[unit]]\nserver_id = { identifier = [1, 256] }",
    "[[unit]]\nidentification = { Vendor = 'x' }",
    "[[unit]]\nidentification = { 7 = 'x' }",
    "[[unit]]\nidentification = { VendorName = 'ü' }",
    "[[unit]]\nidentification = { VendorName = 'a', 0 = 'b' }",
    f"[[unit]]\nidentification = {{ 128 = '{'x' * 245}' }}",
    "[[unit]]\ncoils = 8",
    "[[unit]]\n[[unit.coils]]",
    "[[unit]]\n[[unit.coils]]\naddress = 0\ntype = 'int16'",
    "[[unit]]\n[[unit.coils]]\naddress = 0\ntable = 'coils'",
    "[[unit]]\n[[unit.coils]]\naddress = 0\nvalues = [true, 2]",
    "[[unit]]\n[[unit.discrete_inputs]]\naddress = 0\naccess = 'read_write'",
    "[[unit]]\n[[unit.holding_registers]]\naddress = 65536",
    HOLDING + "count = 0",
    HOLDING.replace("0\n", "65534\n") + "values = [1, 2, 3]",
    HOLDING + "value = 1\nvalues = [1]",
    HOLDING + "value = 1\ncounter = {}",
    HOLDING + "values = [1]\ncount = 1",
    HOLDING + "values = []",
    HOLDING + "values = 1",
    HOLDING + "values = [1, -1]",
    HOLDING + "value = 1.5",
    HOLDING + "type = 'quux'",
    HOLDING + "type = 1",
    HOLDING + "type = 'int32'\norder = 'ABDC'",
    HOLDING + "minimum = 5\nvalue = 4",
    HOLDING + "type = 'string:4'\nencoding = 'klingon'",
    HOLDING + "type = 'string:4'\nvalue = 'abcde'",
    HOLDING + "type = 'bits16'\nvalue = [2]",
    HOLDING + "access = 'readonly'",
    HOLDING + "access = 'read_write'\ncounter = {}",
    HOLDING + "count = 5\n[[unit.holding_registers]]\naddress = 4",
    HOLDING + "counter = 1",
    HOLDING + "counter = { stop = 1 }",
    HOLDING + "counter = { step = 0 }",
    HOLDING + "counter = { step = inf }",
    HOLDING + "counter = { step = '1' }",
    HOLDING + "counter = { interval = 0 }",
    HOLDING + "counter = { start = 5, wrap = 5 }",
    HOLDING + "counter = { step = -1, start = 5, wrap = 6 }",
    HOLDING + "counter = { wrap = 65537 }",
    HOLDING + "counter = { start = -1 }",
    HOLDING + "type = 'string:2'\ncounter = {}",
    HOLDING + "sine = { low = 1 }",
    HOLDING + "sine = { low = 1, high = 1, period = 1 }",
    HOLDING + "sine = { low = nan, high = 1, period = 1 }",
    HOLDING + "type = 'float64'\nsine = { low = 0, high = 1e101, period = 1 }",
    HOLDING + "sine = { low = 0, high = 65536, period = 1 }",
    HOLDING + "type = 'float32'\nsine = { low = 0, high = 1e39, period = 1 }",
    HOLDING + "random_walk = { low = 0, high = 9, step = 10 }",
    HOLDING + "random_walk = { low = 0, high = 9, step = 1, seed = 'x' }",
    HOLDING + "copy = { address = 0 }",
    HOLDING + "copy = { table = 'holding', address = 0 }",
    HOLDING + "copy = { table = 'coils', address = 0 }",
    HOLDING + "copy = { table = 'input_registers', address = 1 }\n" + INPUT + "type = 'int32'",
    HOLDING + "count = 2\ncopy = { table = 'input_registers', address = 0 }\n" + INPUT,
    HOLDING + "copy = { table = 'input_registers', address = 0 }\n" + INPUT + "type = 'string:2'",
    HOLDING
    + "type = 'bits16'\ncopy = { table = 'input_registers', address = 0, scale = 2 }\n"
    + INPUT
    + "type = 'bits16'",
    HOLDING + "copy = { table = 'holding_registers', address = 0 }",
    HOLDING
    + "count = 9\ncopy = { table = 'holding_registers', address = 1 }\n"
    + "[[unit.holding_registers]]\naddress = 9",
    "[[unit]]\n[[unit.file]]\nnumber = 0",
    "[[unit]]\n[[unit.file]]\nnumber = 0\nrecord = 0",
    "[[unit]]\n[[unit.file]]\nnumber = 1\nrecord = 9999\ncount = 2",
    "[[unit]]\n[[unit.file]]\nnumber = 1\nrecord = 0\ncounter = {}",
    "[[unit]]\n[[unit.file]]\nnumber = 1\nrecord = 0\n[[unit.file]]\nnumber = 2\nrecord = 0\n"
    "[[unit.file]]\nnumber = 1\nrecord = 0",
    "[[unit]]\n[[unit.fifo]]\naddress = 0",
    "[[unit]]\n[[unit.fifo]]\naddress = 0\nvalues = [65536]",
    f"[[unit]]\n[[unit.fifo]]\naddress = 0\nvalues = {[0] * 32}",
    "[[unit]]\n" + "[[unit.fifo]]\naddress = 0\nvalues = []\n" * 2,
    FAULT,
    FAULT + "kind = 'slow'",
    FAULT + "kind = 'delay'",
    FAULT + "kind = 'delay'\ndelay = 1",
    "[[unit]]\n[[fault]]\nkind = 'no_answer'\nevery = 0",
]

NAMES_AND_MAPS = [
    "[[unit]]\nmap = 5",
    "[[unit]]\nmap = [5]",
    "[[unit]]\nmap = 'none.csv'",
    "[[unit]]\nmap = 'device.doc'",
    "[[unit]]\nmap = ['meter.csv', 'meter.csv']",
    "[[unit]]\nmap = 'bad.csv'",
    MAPPED + "values = { volt = 1 }",
    "[[unit]]\nvalues = { a = 1 }",
    MAPPED + "values = { voltage = 6553.6 }",
    MAPPED + "values = { pump = 2 }",
    MAPPED + "moves = { voltage = 1 }",
    MAPPED + "moves = { voltage = {} }",
    MAPPED + "moves = { voltage = { counter = {}, sine = { low = 1, high = 2, period = 1 } } }",
    MAPPED + "moves = { voltage = { sin = 1 } }",
    MAPPED + "moves = { voltage = { counter = { start = 7000 } } }",
    MAPPED + "moves = { voltage = { counter = {} } }\nvalues = { voltage = 1 }",
    MAPPED + "moves = { status = { counter = {} }, 'status high' = { counter = {} } }",
    MAPPED + "[[unit.input_registers]]\naddress = 3",
    MAPPED + "[[unit.coils]]\naddress = 9\nname = 'pump'",
    "[[unit]]\n" + INPUT + "scale = 0",
    "[[unit]]\n" + INPUT + "scale = 'a'",
    "[[unit]]\n" + INPUT + "type = 'bits16'\nscale = 2",
    "[[unit]]\n" + INPUT + "scale = 0.1\nvalue = 7000",
    "[[unit]]\n" + INPUT + "name = ''",
    "[[unit]]\n" + INPUT + "units = 5",
    "[[unit]]\nname = 5",
    "[[unit]]\ndefaults = 5",
    "[[unit]]\ndefaults = { value = 5 }",
    "[[unit]]\n[defaults]\ntype = 'x'",
    "[[unit]]\n[defaults]\norder = 'x'",
    "[[unit]]\n[[unit.fault]]\nkind = 'garbage'\ndata = [256]",
]

MEANINGS = [
    RANGE + "bit = 16\n",
    RANGE + "scale_from = 'b'\n",
    RANGE + "scale_from = 'b'\n" + SECOND.replace("0", "1") + "scale_from = 'a'\n",
    RANGE + "scale_from = 'b'\nvalue = 7\n" + SECOND.replace("0", "1") + "value = 300\n",
    RANGE + "bit = 3\n" + SECOND + "bit = '2..5'\n",
    RANGE + "bit = 3\n" + SECOND,
    RANGE + "bit = 3\n" + SECOND.replace("'b'", "'a'") + "bit = 4\n",
    RANGE + "states = { 0 = 'x', 1 = 'x' }\n",
    RANGE + "type = 'date48'\ntime_zone = 'Europe/Berlyn'\n",
    RANGE + "interval = 0\n",
    RANGE + "scale_from = 'b'\ncounter = {}\n" + SECOND.replace("0", "1"),
]

LINES = [
    "[[unit]]\n[[units]]\n",
    "[[unit]]\n[unit.foo]\nx = 1\n",
    "[[unit]]\nid = 1\n[[unit.foo]]\nx = 1\n",
    "[[unit]]\nid = 1\n[unit.foo.bar]\n",
    "[[unit]]\nid = 1\nfoo.bar = 1\n",
    "[[unit]]\nid = 1\n[unit.'my table']\nid = 2\n",
    '[[unit]]\nid = 1\n[[unit."a.b"]]\n',
    "[[unit]]\nid = 1\n'my id' = 1\n",
    "[[unit]]\n[[unit.coils]]\naddress = 0\ncounter.stop = 1\n",
    "[[unit]]\n[[unit.coils]]\naddress = 0\n[unit.coils.sine]\nx = 1\n",
    "# a\u2028b\x85c\n[[unit]]\nfoo = 1\n",
    "[[unit]]\r\n[[unit.foo]]\r\n",
]

ROLES = [
    "[[roles]]",
    "[roles]\nViewer = 5",
    "[roles.Viewer]\nreads = 5",
    "[roles.Viewer]\nread = 5",
    '[roles.Viewer]\nread = "coils"',
    '[roles.Viewer]\n\nread = ["coil"]',
    '[roles.Viewer]\nread = ["coils", 5]',
    '[roles.Viewer]\nwrite = ["fifo"]',
    "[roles.Viewer]\nread = [{address = 5}]",
    '[roles.Viewer]\nread = [{table = "coils", address = 5}]',
    '[roles.Viewer]\nread = [{table = "coils", address = 5, count = 65536}]',
    '[roles.Viewer]\nread = [{table = "coils", address = 5, count = 1, unit = 3}]',
    '[roles.Viewer]\nread = [{table = "coils", address = "5", count = 1}]',
    '[roles.Viewer]\nread = [{table = "coils", address = [5], count = {a = 1}}]',
    "[roles.Viewer]\nfunctions = [3]",
    "[roles.Viewer]\nfunctions = [[]]",
    "[roles.Viewer]\nfunctions = 17",
    '[roles."a\\nb"]',
]

SHORT = reprlib.Repr()
SHORT.maxstring = 160


def test_a_wrong_file_is_told_what_is_wrong(tmp_path: Path, golden: Golden) -> None:
    (tmp_path / "meter.csv").write_text(METER)
    (tmp_path / "bad.csv").write_text("name,table,address\na,coilz,0\n")
    roles = [f"{text}\n[[unit]]\n" for text in ROLES]
    of_units = [f"[[unit]]\n{text.replace('roles', 'unit.roles')}\n" for text in ROLES[:5]]
    lines = []
    for text in (*TABLES_AND_KEYS, *NAMES_AND_MAPS, *MEANINGS, *LINES, *roles, *of_units):
        path = tmp_path / "device.toml"
        path.write_text(text, newline="")
        with pytest.raises(DeviceFileError) as caught:
            load(path)
        message = str(caught.value).replace(str(tmp_path), "FOLDER")
        assert "\n" not in message
        lines += [SHORT.repr(text), f"    {message}", ""]
    golden("mistakes.txt", "\n".join(lines))


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
