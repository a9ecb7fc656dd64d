"""
Lines of keys in TOML texts.
"""

from __future__ import annotations

from libmodbus_py.protocol.mistakes import Path
from libmodbus_py.tools.files.texts import line_of
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
