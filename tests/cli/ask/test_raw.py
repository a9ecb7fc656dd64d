"""
The command raw.
"""

from __future__ import annotations

from tests.support.cases import each_case
from tests.support.commands import run


@each_case(
    ("words", "code", "said"),
    [
        ("3 0000 0002", 0, "03 04 00 01 00 02\n"),
        ("3 0000 0002", 0, "ReadHoldingRegisters(address=0, count=2): [1, 2]\n"),
        ("0x2B 0E0100", 0, "2b 0e 01"),
        ("7", 0, "07 00\n"),
        ("43 0D0102", 1, "illegal function (exception 1)"),
        ("100 00", 1, "illegal function (exception 1)"),
        ("3 1388 0001", 1, "illegal data address (exception 2)"),
        ("3 xyz", 2, "HEX must be pairs of hex digits, not 'xyz'"),
        ("200", 2, "function must be in 1..127"),
        ("three", 2, "function must be a number"),
    ],
)
def test_raw(url: str, words: str, code: int, said: str) -> None:
    done = run("raw", url, *words.split())
    assert done.code == code
    assert said in (done.out if code == 0 else done.err)
    assert done.err.count("\n") == (code != 0)
