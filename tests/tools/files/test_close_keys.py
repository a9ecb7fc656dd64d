"""
Keys of files that do not exist: the error names the one that was meant.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import load
from tests.support.cases import each_case

DEVICE = """
[[device]]
name = "a"
map = "sdm120"
url = "rtu:///dev/ttyUSB0"
"""
ROUTE = """
[[route]]
to = "rtu:///dev/ttyUSB0"
"""
POINT = """
[[point]]
name = "a"
table = "coils"
address = 3
"""
SERIAL = "stop_bits is part of the URL of a serial port: rtu:///dev/ttyUSB0?stop_bits=..."


@each_case(
    ("text", "meant"),
    [
        (DEVICE + "stopbits = 2", SERIAL),
        (DEVICE + "slave = 2", "did you mean unit?"),
        (DEVICE + "intervall = 2", "did you mean interval?"),
        (ROUTE + "stopbits = 2", SERIAL),
        (ROUTE + "unit = 2", "did you mean units?"),
        (POINT + "data_type = 'uint16'", "did you mean type?"),
        ("[[unit]]\nid = 1\nidentity = {}", "did you mean identification?"),
    ],
)
def test_a_wrong_key(tmp_path: Path, text: str, meant: str) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match="no such key; allowed are ") as raised:
        load(file)
    assert str(raised.value).endswith(f"; {meant}")


def test_a_long_key_is_compared_with_none(tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(DEVICE + "interval" * 9 + " = 2")
    with pytest.raises(ValueError, match="no such key; allowed are ") as raised:
        load(file)
    assert "did you mean" not in str(raised.value)
