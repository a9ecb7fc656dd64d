"""Bits in device files: by number, by range, and by name."""

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, device_file
from tests.support.cases import each_case

COILS = "[[unit.coils]]\naddress = 5\nname = 'x'\ncount = 8\n"
WORD = "[[unit.holding_registers]]\naddress = 5\nname = 'x'\ntype = 'bits16'\n"


def value_of(text: str) -> Any:
    device = device_file.parse("[[unit]]\n" + text).devices
    assert isinstance(device, Device)
    value = device["x"]
    return [at for at, is_on in enumerate(value) if is_on] if isinstance(value, list) else value


@each_case(
    ("text", "value"),
    [
        (WORD + 'value = { 0 = true, "4..6" = true }', [0, 4, 5, 6]),
        (WORD + "value = { 1 = false, else = true }", [0, *range(2, 16)]),
        (WORD + "value = {}", []),
        (WORD.replace("16", "32") + "value = { 31 = true }", [31]),
        (
            WORD + "bits = { 0 = 'door', '4..7' = 'code' }\nvalue = { code = 9 }",
            {"door": False, "code": 9},
        ),
        (COILS + 'value = { 5 = true, "8..10" = true }', [0, 3, 4, 5]),
        (COILS.replace("count = 8", "value = { 5 = true }"), True),
        (COILS.replace("coils", "discrete_inputs") + "value = { 12 = true }", [7]),
    ],
)
def test_bits_by_number_range_and_name(text: str, value: Any) -> None:
    assert value_of(text) == value


@each_case(
    ("text", "message"),
    [
        (WORD + "value = { 16 = true }", "value.16 must be in 0..15, not 16"),
        (WORD + 'value = { "0..3" = true, 2 = true }', "value.2: 2 is given twice"),
        (WORD + "value = { 0 = 1 }", "value.0 must be true or false, not 1"),
        (WORD + "value = { door = true }", "value.door: the key must be a number, a range such as"),
        (WORD + 'value = { "5..2" = true }', "value.5..2 must have the lower number first"),
        (WORD + "count = 2\nvalue = { 0 = true }", "value must be a list, not dict"),
        (COILS + "value = { 0 = true }", "value.0 must be in 5..12, not 0"),
    ],
)
def test_an_invalid_bit_is_named(text: str, message: str) -> None:
    with pytest.raises(device_file.DeviceFileError, match=message):
        value_of(text)


def test_points_of_a_map_have_named_bits(tmp_path: Path) -> None:
    (tmp_path / "map.csv").write_text(
        "name,table,address,type,count\nlamps,coil,8,,8\nword,holding,0,bits16,\npump,coil,30,,\n"
    )
    text = 'lamps = { "9..11" = true }\nword = { 15 = true }\npump = { 30 = true }\n'
    text = f'[[unit]]\nmap = "map.csv"\n[unit.values]\n{text}'
    device = device_file.parse(text, folder=tmp_path).devices
    assert isinstance(device, Device)
    assert device["lamps"] == [False, True, True, True, False, False, False, False]
    assert (device["word"].index(True), device["pump"]) == (15, True)
