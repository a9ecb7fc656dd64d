"""
The command sunspec.
"""

from __future__ import annotations

from tests.support.commands import run
from tests.support.sunspec import file_device, serving


def test_the_values_of_all_models_are_printed() -> None:
    with serving(file_device("device_1547.json")) as url:
        done = run("sunspec", url)
    assert (done.code, done.err) == (0, "")
    lines = [" ".join(line.split()) for line in done.out.splitlines()]
    assert "40004 common.Mn SunSpecTest" in lines
    assert any(line.endswith("DERMeasureAC.W 9800 W") for line in lines)
    assert not any("InvSt" in line for line in lines)
