"""
Options that name an address to listen on: there is one, and a second is refused.
"""

from __future__ import annotations

from tests.support.cases import each_case
from tests.support.commands import run

COMMANDS = [
    ("serve", "tcp://127.0.0.1:0"),
    ("gateway", "tcp://127.0.0.1:0", "--route", "1=tcp://127.0.0.1:1"),
    ("poll", "fleet.toml"),
]


@each_case(
    ("option", "command"),
    [(option, command) for option in ("--metrics", "--page") for command in COMMANDS],
)
def test_a_second_address_is_refused(option: str, command: tuple[str, ...]) -> None:
    given = [option, "127.0.0.1:9400", option, "127.0.0.1:9401"]
    found = run(*command, *given)
    assert found.code == 2
    last = found.err.splitlines()[-1]
    assert option in last
    assert "may be given once" in last
    assert "Traceback" not in found.err
