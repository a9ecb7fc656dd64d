"""
Listeners and TLS: what is encrypted cannot be heard, and the error says what shows it.
"""

from __future__ import annotations

import pytest

from libmodbus_py.listen import listen
from tests.support.cases import each_case
from tests.support.commands import run

SECURE = "tls://127.0.0.1:802"

PLACES = [
    (SECURE, None),
    (SECURE, "tls://192.0.2.10"),
    ("rtu+tcp://127.0.0.1:0", "tls://192.0.2.10"),
    ("rtu:///dev/ttyUSB0", "tls://192.0.2.10"),
]


@each_case(("url", "between"), PLACES)
def test_tls_is_refused_with_what_shows_it(url: str, between: str | None) -> None:
    with pytest.raises(ValueError, match="cannot see into TLS; a gateway") as raised:
        listen(url, between=between)
    assert str(raised.value).startswith("tls://")


def test_the_command_and_its_help_say_so() -> None:
    done = run("listen", SECURE)
    assert (done.code, done.out) == (2, "")
    assert "listening cannot see into TLS; a gateway" in done.err
    assert "Traffic in TLS cannot be read; libmodbus-py gateway -v" in run("listen", "--help").out
