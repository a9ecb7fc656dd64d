"""
serve with a device file that is wrong.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.commands import run


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read {}: No such file or directory"),
        ("[[unit]]\nid = 999", "{}, line 2: unit[0].id must be in 0..255, not 999"),
        ("[[unit]", "{}: Expected ']]' at the end of an array declaration (at line 1, column 7)"),
    ],
)
def test_a_wrong_file_is_one_line_and_exit_code_2(
    content: str | None, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "device.toml"
    if content is not None:
        path.write_text(content)
    done = run("serve", "tcp://127.0.0.1:0", "--device", path)
    assert done.code == 2
    assert done.out == ""
    assert done.err.startswith(f"libmodbus-py: {message.format(path)}")
    assert done.err.count("\n") == 1
