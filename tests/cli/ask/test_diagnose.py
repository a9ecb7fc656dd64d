"""
The command diagnose.
"""

from __future__ import annotations

from tests.support.commands import run


def test_diagnose(url: str) -> None:
    done = run("diagnose", url)
    assert "exception status               00000000\n" in done.out
    assert "bus message count " in done.out
    assert run("diagnose", url, "return-query-data", "0x1234").out == "4660\n"
    assert run("diagnose", url, "0", "7", "--json").out == '{"unit": 1, "return query data": 7}\n'
    assert run("diagnose", url, "99").code == 1
    assert "one of return-query-data" in run("diagnose", url, "nonsense").err
