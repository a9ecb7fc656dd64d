"""
The keys of files: a wrong key is told with the one that was meant; and amounts with units.
"""

from pathlib import Path

import pytest

from libmodbus_py import load
from libmodbus_py.files.csv_text import CELLS
from libmodbus_py.files.schema import in_bytes, in_seconds
from libmodbus_py.maps.list_cells import READERS
from libmodbus_py.maps.map_file import POINT
from libmodbus_py.services.fleet import files as fleet_files
from tests.support.cases import each_case


def test_every_key_can_stand_in_a_cell_that_csv_has_a_column_for() -> None:
    assert set(POINT) <= set(READERS)
    not_in_cells = {"map", "dead_bands", "labels"}
    columns = {key.name for key in fleet_files.DEVICE.values() if key.kind in CELLS}
    assert columns == set(fleet_files.DEVICE) - not_in_cells


# --- keys that do not exist ------------------------------------------------------------------

DEVICE_TEXT = """
[[device]]
name = "a"
map = "sdm120"
url = "rtu:///dev/ttyUSB0"
"""
ROUTE_TEXT = """
[[route]]
url = "rtu:///dev/ttyUSB0"
"""
POINT_TEXT = """
[[point]]
name = "a"
table = "coils"
address = 3
"""
SERIAL = "stop_bits is part of the URL of a serial port: rtu:///dev/ttyUSB0?stop_bits=..."


@each_case(
    ("text", "meant"),
    [
        (DEVICE_TEXT + "stopbits = 2", SERIAL),
        (DEVICE_TEXT + "slave = 2", "did you mean unit?"),
        (DEVICE_TEXT + "intervall = 2", "did you mean interval?"),
        (ROUTE_TEXT + "stopbits = 2", SERIAL),
        (ROUTE_TEXT + "unit = 2", "did you mean units?"),
        (POINT_TEXT + "data_type = 'uint16'", "did you mean type?"),
        ("[[unit]]\nid = 1\nidentity = {}", "did you mean identification?"),
    ],
)
def test_a_wrong_key(tmp_path: Path, text: str, meant: str) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match="no such key; allowed are ") as raised:
        load(file)
    assert str(raised.value).endswith(f"; {meant}")


# --- times and sizes with units --------------------------------------------------------------


def test_amounts_have_units() -> None:
    for given, value in (("90 days", 7_776_000), ("1.5h", 5400), ("2 weeks", 1_209_600)):
        assert in_seconds("keep", given, "1 s", "100 years") == value
    for given, value in (("2 GB", 2 * 10**9), ("1 GiB", 1 << 30), ("0.5 MB", 500_000)):
        assert in_bytes("size", given, "1 B", "1 TB") == value


@each_case(
    ("given", "error"),
    [
        (90, TypeError),
        ("90", ValueError),
        ("ninety days", ValueError),
        ("-1 days", ValueError),
        ("1e9 days", ValueError),
        ("90 Days", ValueError),
        ("1 GB", ValueError),
        ("1 s", ValueError),
        ("101 years", ValueError),
        ("9" * 400 + " days", ValueError),
        ("", ValueError),
    ],
)
def test_a_wrong_amount_is_named_with_what_is_allowed(
    given: object, error: type[Exception]
) -> None:
    with pytest.raises(error, match=r'^keep must be a time in "1 minute".."100 years", not '):
        in_seconds("keep", given, "1 minute", "100 years")
