"""
Endpoints without a scheme, and options that fit no endpoint.
"""

from __future__ import annotations

import pytest

from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.names import resolve


@each_case(
    ("where", "said"),
    [
        (["127.0.0.1:1"], "cannot connect to 127.0.0.1:1"),
        (["plc.example:1"], "cannot connect to plc.example:1"),
        (["[::1]:1"], "cannot connect to [::1]:1"),
        (["127.0.0.1:1?unit=9"], "unit 9: cannot connect"),
        (["127.0.0.1:1?unit=9", "-u", "8"], "unit 8: cannot connect"),
        (["/dev/no-such", "-b", "9600", "-p", "none", "-s", "2"], "cannot open /dev/no-such"),
        (["./no-such"], "no-such: No such file"),
        (["127.0.0.1:1", "-b", "9600"], "--baudrate applies to serial ports only"),
        (["tcp://127.0.0.1:1", "-s", "2"], "--stop-bits applies to serial ports only"),
        (["/dev/no-such", "-p", "mark"], "must be none, even or odd"),
        (["http://127.0.0.1"], "scheme must be one of"),
        (["a b:c:d"], "'a b:c:d'"),
        (["user@host"], "must be a URL"),
        ([""], "must be a URL"),
    ],
)
def test_endpoints_without_a_scheme(
    monkeypatch: pytest.MonkeyPatch, where: list[str], said: str
) -> None:
    resolve(monkeypatch, "plc.example")
    done = run("read", *where, "holding", "0")
    assert done.code in (1, 2)
    assert said in done.err
    assert done.err.count("\n") == 1
