"""The default values that docstrings and pages name are those of the code."""

import ast
import pydoc
import re
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, Point
from libmodbus_py.client.asynchronous import MAX_PAUSE
from libmodbus_py.client.options import AsyncOptions, Options
from libmodbus_py.ports.options import SERIAL_DEFAULTS, SERIAL_OPTIONS, rows_of
from libmodbus_py.server.limits import Limits
from libmodbus_py.services.fleet.config import DeviceConfig
from libmodbus_py.services.gateway.routes import GatewayOptions
from tests.support.cases import each_case

DOCS = Path(__file__).parents[2] / "docs"

ROWS = rows_of(AsyncOptions)

CLIENTS: dict[str, Any] = {
    name: row.default for name, row in ROWS.items() if name not in SERIAL_OPTIONS
}

NAMED = re.compile(r"([^.|(]*(?:\.\d[^.|(]*)*)\(`(\w+)`\)")
"""On a page: the words before an option in parentheses, from the beginning of the sentence on."""

NUMBER_WORDS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5}


def value(text: str) -> Any:
    return ast.literal_eval(text)


LISTED = re.compile(r"^ +\| +(\w+)=(\S+) +\S", re.MULTILINE)
"""An option and its default, as help shows it among the methods of a class."""


@each_case(
    ("client", "options", "usual"),
    [(Client, Options, {}), (AsyncClient, AsyncOptions, {"max_pause": MAX_PAUSE})],
)
def test_help_lists_every_option_with_its_default(client: Any, options: Any, usual: Any) -> None:
    defaults = {name: row.default for name, row in rows_of(options).items()} | usual
    listed = LISTED.findall(pydoc.plaintext.document(client))
    assert {name: value(text) for name, text in listed} == defaults
    assert len(listed) == len(defaults)


@each_case("name", [*ROWS])
def test_an_option_accepts_its_default_and_its_range(name: str) -> None:
    """Its text names the range, and it accepts its default."""
    row = ROWS[name]
    row.check(name, row.default)
    for low, high in re.findall(r"(\d\S*)\.\.(\d+)", row.summary):
        for wrong in (float(low) / 2 - 1, float(high) + 1):
            number = wrong if isinstance(row.default, float) else int(wrong)
            with pytest.raises(ValueError, match=rf"^{name} must be in {low}\.\.{high}"):
                row.check(name, number)


@pytest.mark.parametrize("client", [Client, AsyncClient])
@pytest.mark.parametrize("method", ["execute", "read_many", "watch"])
def test_help_of_typed_methods_contains_their_docstrings(client: type[Any], method: str) -> None:
    text = pydoc.plaintext.document(getattr(client, method))
    assert re.search(r"\n    [A-Z].*\.\n[^$]*Args:", text), text


def test_the_page_has_each_option_with_its_default() -> None:
    """And its text, as `./run lint` compares."""
    page = (DOCS / "defaults.md").read_text()
    rows = dict(re.findall(r"(?m)^\| `(\w+)` \| `(.+?)` \|", page.partition("## Limits")[0]))
    assert {name: value(text) for name, text in rows.items()} == {
        name: row.default for name, row in ROWS.items()
    }
    for cls in (Limits, GatewayOptions, DeviceConfig, Point):
        names = [field.name for field in fields(cls) if field.init and field.default is not MISSING]
        assert [name for name in names if f"| `{name}` |" not in page] == []


def test_pages_name_the_default_timeout_and_the_serial_settings() -> None:
    seconds = f"{CLIENTS['timeout']:g} s"
    assert f"# {seconds} is the default" in (DOCS / "how-to" / "timeouts.md").read_text()
    usual = "{baudrate} {data_bits}{parity}{stop_bits}".format(**SERIAL_DEFAULTS)
    assert f"[{usual}](../defaults.md" in (DOCS / "how-to" / "serial-ports.md").read_text()


def test_pages_that_name_an_option_with_a_number_name_its_default() -> None:
    compared = set()
    for path in DOCS.rglob("*.md"):
        for words, option in NAMED.findall(" ".join(path.read_text().split())):
            numbers = [
                NUMBER_WORDS[match] if match in NUMBER_WORDS else float(match)
                for match in re.findall(r"\d+(?:\.\d+)?|\b(?:one|two|three|four|five)\b", words)
            ]
            if option in CLIENTS and numbers:
                assert CLIENTS[option] in numbers, f"{path.name}: {words}({option})"
                compared.add(option)
    assert "turnaround" in compared
