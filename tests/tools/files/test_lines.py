"""
Lines of keys in TOML texts.
"""

from __future__ import annotations

import re
from pathlib import Path as FilePath

import pytest

from libmodbus_py.protocol.mistakes import Path
from libmodbus_py.tools.files.texts import line_of
from libmodbus_py.tools.simulator.device_file import DeviceFileError, load
from tests.support.cases import each_case

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


@each_case(
    ("path", "line"),
    [
        ((), None),
        (("title",), 2),
        (("unit", 0), 3),
        (("unit", 0, "id"), 4),
        (("unit", 0, "server_id", "running"), 6),
        (("unit", 0, "server_id", "additional"), 5),
        (("unit", 0, "coils", 0, "address"), 8),
        (("unit", 0, "coils", 1), 9),
        (("unit", 0, "coils", 1, "counter", "step"), 11),
        (("unit", 0, "coils", 1, "address", 3), 10),
        (("unit", 1, "coils", 0, "value"), 14),
        (("unit", 1, "id"), 12),
        (("unit", 2, "id"), None),
        (("fault",), None),
    ],
)
def test_a_key_is_found_in_its_own_table(path: Path, line: int | None) -> None:
    assert line_of(TEXT, path) == line


# A mistake, which line it is on, and the path that its message begins with.
MISTAKES = [
    ("[[unit]]\n[[units]]\n", 2, "units"),
    ("[[unit]]\n[unit.foo]\nx = 1\n", 2, "unit[0].foo"),
    ("[[unit]]\nid = 1\n[[unit.foo]]\nx = 1\n", 3, "unit[0].foo"),
    ("[[unit]]\nid = 1\n[unit.foo.bar]\n", 3, "unit[0].foo"),
    ("[[unit]]\nid = 1\nfoo.bar = 1\n", 3, "unit[0].foo"),
    ("[[unit]]\nid = 1\n[unit.'my table']\nid = 2\n", 3, "unit[0].'my table'"),
    ('[[unit]]\nid = 1\n[[unit."a.b"]]\n', 3, "unit[0].'a.b'"),
    ("[[unit]]\nid = 1\n'my id' = 1\n", 3, "unit[0].'my id'"),
    ("[[unit]]\n[[unit.coils]]\naddress = 0\ncounter.stop = 1\n", 4, "unit[0].coils[0].counter"),
    ("[[unit]]\n[[unit.coils]]\naddress = 0\n[unit.coils.sine]\nx = 1\n", 5, "unit[0].coils[0]"),
    ("# a\u2028b\x85c\n[[unit]]\nfoo = 1\n", 3, "unit[0].foo"),
    ("[[unit]]\r\n[[unit.foo]]\r\n", 2, "unit[0].foo"),
]


@each_case(("text", "line", "message"), MISTAKES)
def test_a_mistake_in_an_unknown_table_names_its_own_line(
    text: str, line: int, message: str, tmp_path: FilePath
) -> None:
    path = tmp_path / "plant.toml"
    path.write_bytes(text.encode())
    with pytest.raises(DeviceFileError, match=re.escape(f"plant.toml, line {line}: {message}")):
        load(path)


def test_errors_name_the_line(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "plant.toml"
    path.write_text("[[unit]]\nid = 1\n\n[[unit.coils]]\naddress = 0\naccess = 'never'\n")
    with pytest.raises(DeviceFileError, match=r"plant.toml, line 6: unit\[0\].coils\[0\].access "):
        load(path)
