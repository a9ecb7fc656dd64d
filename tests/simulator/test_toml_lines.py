"""
Lines of keys in TOML texts.
"""

from __future__ import annotations

import pytest

from libmodbus_py.simulator.device_file import DeviceFileError, load
from libmodbus_py.simulator.toml_lines import line_of

TEXT = """\
# a comment with key = 1
title = 3
[[unit]]
id = 1
[unit.server_id]
running = true
[[unit.coils]]
address = 0
[[unit.coils]]
address = 10
counter = { step = 1 }
[[unit]]
[[unit.coils]]
value = true
"""


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("title", 2),
        ("unit[0]", 3),
        ("unit[0].id", 4),
        ("unit[0].server_id.running", 6),
        ("unit[0].server_id.additional", 5),
        ("unit[0].coils[0].address", 8),
        ("unit[0].coils[1]", 9),
        ("unit[0].coils[1].counter.step", 11),
        ("unit[0].coils[1].address[3]", 10),
        ("unit[1].coils[0].value", 14),
        ("unit[1].id", 12),
        ("unit[2].id", None),
        ("fault", None),
    ],
)
def test_a_key_is_found_in_its_own_table(path: str, line: int | None) -> None:
    assert line_of(TEXT, path) == line


def test_errors_name_the_line(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "plant.toml"
    path.write_text("[[unit]]\nid = 1\n\n[[unit.coils]]\naddress = 0\naccess = 'never'\n")
    with pytest.raises(DeviceFileError, match=r"plant.toml, line 6: unit\[0\].coils\[0\].access "):
        load(path)
