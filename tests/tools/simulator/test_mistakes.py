"""
Device files that are wrong, and what is said of them.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.tools.simulator.device_file import DeviceFileError, load, parse
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import HOLDING

FAULT = "[[unit]]\n[[unit.fault]]\n"
AT = "unit[0].holding_registers[0]"
FLOAT = "-3.4028234663852886e+38..3.4028234663852886e+38"

BROKEN = [
    ("[[unit]", "Expected ']]' at the end of an array declaration (at line 1, column 7)"),
    ("[[unit]]\nid = 1\nid = 2\n", "Cannot overwrite a value (at line 3, column 7)"),
    ("", "unit is missing"),
    ("unit = []", "unit must not be empty"),
    ("a = " + "[" * 10_000, "too many levels of tables or lists"),
    ("[unit]", "unit must be a list of tables: [[unit]]"),
    ("unit = [1]", "unit[0] must be a table, not 1"),
    (
        "units = []",
        "units: no such key; allowed are unit, fault, roles, defaults; did you mean unit?",
    ),
    (
        "'my unit' = []",
        "'my unit': no such key; allowed are unit, fault, roles, defaults; did you mean unit?",
    ),
    ("[[unit]]\nid = 248", "unit[0].id must be in 0..247, or 255, not 248"),
    ("[[unit]]\nid = -1", "unit[0].id must be in 0..255, not -1"),
    ("[[unit]]\nid = '1'", "unit[0].id must be an integer in 0..255, not str"),
    ("[[unit]]\nid = true", "unit[0].id must be an integer in 0..255, not True"),
    ("[[unit]]\nid = 1\n[[unit]]\nid = 1", "unit[1].id: there is already a unit 1"),
    (
        "[[unit]]\nid = 1\n[[unit]]",
        "unit[1].id is missing; only a single unit can be without",
    ),
    ("[[unit]]\n[[unit]]", "unit[0].id is missing; only a single unit can be without"),
    (
        "[[unit]]\nnames = 'x'",
        "unit[0].names: no such key; allowed are id, name, description, exception_status,"
        " server_id, identification, defaults, map, values, moves, coils, discrete_inputs,"
        " holding_registers, input_registers, file, fifo, fault, roles;"
        " did you mean name or moves?",
    ),
    ("[[unit]]\nexception_status = 256", "unit[0].exception_status must be in 0..255, not 256"),
    ("[[unit]]\nserver_id = 1", "unit[0].server_id must be a table, not 1"),
    (
        "[[unit]]\nserver_id = { name = 1 }",
        "unit[0].server_id.name: no such key; allowed are identifier, running, additional",
    ),
    (
        "[[unit]]\nserver_id = { running = 1 }",
        "unit[0].server_id.running must be true or false, not 1",
    ),
    (
        "[[unit]]\nserver_id = { identifier = '' }",
        "unit[0].server_id.identifier must have 1..125 bytes, not 0",
    ),
    (
        "[[unit]]\nserver_id = { identifier = [1, 256] }",
        "unit[0].server_id.identifier[1] must be in 0..255, not 256",
    ),
    (
        "[[unit]]\nidentification = { Vendor = 'x' }",
        "unit[0].identification.Vendor: no such key; allowed are VendorName, ProductCode,"
        " MajorMinorRevision, VendorUrl, ProductName, ModelName, UserApplicationName, and the"
        " numbers 0..6, 128..255; did you mean VendorUrl or VendorName?",
    ),
    (
        "[[unit]]\nidentification = { 7 = 'x' }",
        "unit[0].identification.7: no such key; allowed are VendorName, ProductCode,"
        " MajorMinorRevision, VendorUrl, ProductName, ModelName, UserApplicationName, and the"
        " numbers 0..6, 128..255",
    ),
    (
        "[[unit]]\nidentification = { VendorName = 'ü' }",
        "unit[0].identification.VendorName must be ASCII text or a list of bytes, not 'ü'",
    ),
    (
        "[[unit]]\nidentification = { VendorName = 'a', 0 = 'b' }",
        "unit[0].identification.0: there is already an object 0",
    ),
    (
        f"[[unit]]\nidentification = {{ 128 = '{'x' * 245}' }}",
        "unit[0].identification.128 must have 0..244 bytes, not 245",
    ),
    ("[[unit]]\ncoils = 8", "unit[0].coils must be a list of tables: [[unit.coils]]"),
    ("[[unit]]\n[[unit.coils]]", "unit[0].coils[0].address is missing"),
    (
        "[[unit]]\n[[unit.coils]]\naddress = 0\ntype = 'int16'",
        "unit[0].coils[0].type must be None for coils, not 'int16'",
    ),
    (
        "[[unit]]\n[[unit.coils]]\naddress = 0\ntable = 'coils'",
        "unit[0].coils[0].table: no such key; allowed are name, address, count, type, order,"
        " encoding, padding, scale, offset, units, access, minimum, maximum, description, missing,"
        " plausible_minimum, plausible_maximum, never_falls, scale_from, scale_as, states, bits,"
        " bit, byte, time_zone, interval, group,"
        " value, values, counter, sine, random_walk, copy; did you mean value or scale?",
    ),
    (
        "[[unit]]\n[[unit.coils]]\naddress = 0\nvalues = [true, 2]",
        "unit[0].coils[0].values[1] must be in 0..1, not 2",
    ),
    (
        "[[unit]]\n[[unit.discrete_inputs]]\naddress = 0\naccess = 'read_write'",
        "unit[0].discrete_inputs[0].access must be read for discrete_inputs, not 'read_write'",
    ),
    (
        "[[unit]]\n[[unit.holding_registers]]\naddress = 65536",
        f"{AT}.address must be in 0..65535, not 65536",
    ),
    (HOLDING + "count = 0", f"{AT}.count must be in 1..65536, not 0"),
    (
        HOLDING.replace("0\n", "65534\n") + "values = [1, 2, 3]",
        f"{AT}.address + count must not pass 65536, but 65534 + 3 does",
    ),
    (HOLDING + "value = 1\nvalues = [1]", f"{AT}.values cannot be given together with value"),
    (HOLDING + "value = 1\ncounter = {}", f"{AT}.counter cannot be given together with value"),
    (HOLDING + "values = [1]\ncount = 1", f"{AT}.count cannot be given together with values"),
    (HOLDING + "values = []", f"{AT}.values must not be empty"),
    (HOLDING + "values = 1", f"{AT}.values must be a list, not 1"),
    (HOLDING + "values = [1, -1]", f"{AT}.values[1] must be in 0..65535, not -1"),
    (HOLDING + "value = 1.5", f"{AT}.value must be an integer in 0..65535, not float"),
    (
        HOLDING + "type = 'quux'",
        f"{AT}.type must be one of int16, int32, int64, uint16, uint32, uint64, float16, float32,"
        " float64, bcd16, bcd32, bcd64, bits16, bits32, bits64, unix32, unix64,"
        " ms64, iec870, date48, bcddate48, date96, string:N, not 'quux'",
    ),
    (HOLDING + "type = 1", f"{AT}.type must be a string, such as float32, not int"),
    (
        HOLDING + "type = 'int32'\norder = 'ABDC'",
        f"{AT}.order must be one of ABCD, CDAB, BADC, DCBA, not 'ABDC'; did you mean BADC or ABCD?",
    ),
    (HOLDING + "minimum = 5\nvalue = 4", f"{AT}.value must be in 5.., not 4"),
    (
        HOLDING + "type = 'string:4'\nencoding = 'klingon'",
        f"{AT}.encoding must be ascii, latin-1, utf-8, cp1252 or another of values.ENCODINGS, not"
        " 'klingon'",
    ),
    (
        HOLDING + "type = 'string:4'\nvalue = 'abcde'",
        f"{AT}.value must have 0..4 bytes in ascii, not 'abcde' with 5",
    ),
    (
        HOLDING + "type = 'bits16'\nvalue = [2]",
        f"{AT}.value must hold 16 bits, lowest first, not 1",
    ),
    (
        HOLDING + "access = 'readonly'",
        f"{AT}.access must be one of read, write, read_write, not 'readonly'",
    ),
    (
        HOLDING + "access = 'read_write'\ncounter = {}",
        f"{AT}.access must be read for what moves by itself",
    ),
    (
        HOLDING + "count = 5\n[[unit.holding_registers]]\naddress = 4",
        "unit[0].holding_registers[1] begins at 4, within unit[0].holding_registers[0] (0..4)",
    ),
    (HOLDING + "counter = 1", f"{AT}.counter must be a table, not 1"),
    (
        HOLDING + "counter = { stop = 1 }",
        f"{AT}.counter.stop: no such key; allowed are step, interval, start, wrap;"
        " did you mean step?",
    ),
    (HOLDING + "counter = { step = 0 }", f"{AT}.counter.step must not be 0"),
    (
        HOLDING + "counter = { step = inf }",
        f"{AT}.counter.step must be in -1e+100..1e+100, not inf",
    ),
    (HOLDING + "counter = { step = '1' }", f"{AT}.counter.step must be a number, not str"),
    (
        HOLDING + "counter = { interval = 0 }",
        f"{AT}.counter.interval must be in 0.001..86400 seconds, not 0",
    ),
    (
        HOLDING + "counter = { start = 5, wrap = 5 }",
        f"{AT}.counter.wrap must be above start, which is 5",
    ),
    (
        HOLDING + "counter = { step = -1, start = 5, wrap = 6 }",
        f"{AT}.counter.wrap must be below start, which is 5",
    ),
    (
        HOLDING + "counter = { wrap = 65537 }",
        f"{AT}.counter.wrap must be in -1..65536 for uint16, not 65537",
    ),
    (
        HOLDING + "counter = { start = -1 }",
        f"{AT}.counter.start must be in 0..65535 for uint16, not -1",
    ),
    (
        HOLDING + "type = 'string:2'\ncounter = {}",
        f"{AT}.counter: only numbers can move by themselves, not string:2",
    ),
    (HOLDING + "sine = { low = 1 }", f"{AT}.sine.high is missing"),
    (
        HOLDING + "sine = { low = 1, high = 1, period = 1 }",
        f"{AT}.sine.high must be above low, which is 1, not 1",
    ),
    (
        HOLDING + "sine = { low = nan, high = 1, period = 1 }",
        f"{AT}.sine.low must be in -1e+100..1e+100, not nan",
    ),
    (
        HOLDING + "sine = { low = 0, high = 65536, period = 1 }",
        f"{AT}.sine.high must be in 0..65535 for uint16, not 65536",
    ),
    (
        HOLDING + "type = 'float32'\nsine = { low = 0, high = 1e39, period = 1 }",
        f"{AT}.sine.high must be in {FLOAT} for float32, not 1e+39",
    ),
    (
        HOLDING + "random_walk = { low = 0, high = 9, step = 10 }",
        f"{AT}.random_walk.step must be more than 0 and up to 9, not 10",
    ),
    (
        HOLDING + "random_walk = { low = 0, high = 9, step = 1, seed = 'x' }",
        f"{AT}.random_walk.seed must be an integer in 0..18446744073709551615, not str",
    ),
    (HOLDING + "copy = { address = 0 }", f"{AT}.copy.table is missing"),
    (
        HOLDING + "copy = { table = 'holding', address = 0 }",
        f"{AT}.copy.table must be one of coils, discrete_inputs, holding_registers,"
        " input_registers, not 'holding'",
    ),
    (
        HOLDING + "copy = { table = 'coils', address = 0 }",
        f"{AT}.copy: in coils no value begins at 0",
    ),
    (
        HOLDING
        + "copy = { table = 'input_registers', address = 1 }\n"
        + "[[unit.input_registers]]\naddress = 0\ntype = 'int32'",
        f"{AT}.copy: in input_registers no value begins at 1",
    ),
    (
        HOLDING
        + "count = 2\ncopy = { table = 'input_registers', address = 0 }\n"
        + "[[unit.input_registers]]\naddress = 0",
        f"{AT}.copy: in input_registers no value begins at 1",
    ),
    (
        HOLDING
        + "copy = { table = 'input_registers', address = 0 }\n"
        + "[[unit.input_registers]]\naddress = 0\ntype = 'string:2'",
        f"{AT}.copy: string:2 cannot be copied to uint16: values that are not numbers need the"
        " same type on both sides, and no scale",
    ),
    (
        HOLDING
        + "type = 'bits16'\ncopy = { table = 'input_registers', address = 0, scale = 2 }\n"
        + "[[unit.input_registers]]\naddress = 0\ntype = 'bits16'",
        f"{AT}.copy: bits16 cannot be copied to bits16: values that are not numbers need the"
        " same type on both sides, and no scale",
    ),
    (
        HOLDING + "copy = { table = 'holding_registers', address = 0 }",
        f"{AT}.copy: more than 8 copies in a row, or a circle of them",
    ),
    (
        HOLDING
        + "count = 9\ncopy = { table = 'holding_registers', address = 1 }\n"
        + "[[unit.holding_registers]]\naddress = 9",
        f"{AT}.copy: more than 8 copies in a row, or a circle of them",
    ),
    ("[[unit]]\n[[unit.file]]\nnumber = 0", "unit[0].file[0].record is missing"),
    (
        "[[unit]]\n[[unit.file]]\nnumber = 0\nrecord = 0",
        "unit[0].file[0].number must be in 1..65535, not 0",
    ),
    (
        "[[unit]]\n[[unit.file]]\nnumber = 1\nrecord = 9999\ncount = 2",
        "unit[0].file[0] ends at 10000, after 9999",
    ),
    (
        "[[unit]]\n[[unit.file]]\nnumber = 1\nrecord = 0\ncounter = {}",
        "unit[0].file[0].counter: no such key; allowed are number, record, count, value, values,"
        " type, order, encoding, padding, access; did you mean count?",
    ),
    (
        "[[unit]]\n[[unit.file]]\nnumber = 1\nrecord = 0\n[[unit.file]]\nnumber = 2\nrecord = 0\n"
        "[[unit.file]]\nnumber = 1\nrecord = 0",
        "unit[0].file[2] begins at 0, within unit[0].file[0] (0..0)",
    ),
    ("[[unit]]\n[[unit.fifo]]\naddress = 0", "unit[0].fifo[0].values is missing"),
    (
        "[[unit]]\n[[unit.fifo]]\naddress = 0\nvalues = [65536]",
        "unit[0].fifo[0].values[0] must be in 0..65535, not 65536",
    ),
    (
        f"[[unit]]\n[[unit.fifo]]\naddress = 0\nvalues = {[0] * 32}",
        "unit[0].fifo[0].values must be 0..31, not 32",
    ),
    (
        "[[unit]]\n" + "[[unit.fifo]]\naddress = 0\nvalues = []\n" * 2,
        "unit[0].fifo[1].address: there is already a queue at address 0",
    ),
    (FAULT, "unit[0].fault[0].kind is missing"),
    (
        FAULT + "kind = 'slow'",
        "unit[0].fault[0].kind must be one of delay, no_answer, exception, wrong_check,"
        " wrong_transaction, wrong_unit, trickle, truncate, disconnect, garbage, not 'slow'",
    ),
    (FAULT + "kind = 'delay'", "unit[0].fault[0].seconds is missing, which delay needs"),
    (
        FAULT + "kind = 'delay'\ndelay = 1",
        "unit[0].fault[0].delay: no such key; allowed are kind, function, every, probability,"
        " seed, seconds, code, length, table, address, count, data, place",
    ),
    (
        "[[unit]]\n[[fault]]\nkind = 'no_answer'\nevery = 0",
        "fault[0].every must be in 1..1000000000, not 0",
    ),
]


@each_case(("text", "message"), BROKEN, ids=range(len(BROKEN)))
def test_a_wrong_file_is_told_what_is_wrong(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text(text)
    with pytest.raises(
        DeviceFileError, match=f"^{re.escape(str(path))}(, line \\d+)?: {re.escape(message)}$"
    ):
        load(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceFileError, match=r"^cannot read .*/none.toml: No such file or dir"):
        load(tmp_path / "none.toml")
    with pytest.raises(DeviceFileError, match=r"^cannot read .*: Is a directory$"):
        load(tmp_path)
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
