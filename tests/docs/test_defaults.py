"""
The default values that docstrings and pages name are those of the code.
"""

from __future__ import annotations

import ast
import inspect
import pydoc
import re
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, Point
from libmodbus_py.client.asynchronous import MAX_PAUSE
from libmodbus_py.client.options import AsyncOptions, CheckedOptions, Options
from libmodbus_py.ports.serial import SERIAL_DEFAULTS
from libmodbus_py.server.limits import Limits
from libmodbus_py.services.fleet.config import DeviceConfig
from libmodbus_py.services.gateway.routes import GatewayOptions

DOCS = Path(__file__).parents[2] / "docs"

SAID = re.compile(r'("?[\w.]+"?)(?: and ("?[\w.]+"?))? by default')
"""A value, or two, and the words that call it a default."""

KEY = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.MULTILINE)
"""A key of an options class in its docstring, and its text."""

CLIENTS: dict[str, Any] = {each.name: each.default for each in fields(CheckedOptions)}

NAMED = re.compile(r"([^.|(]*(?:\.\d[^.|(]*)*)\(`(\w+)`\)")
"""On a page: the words before an option in parentheses, from the beginning of the sentence on."""

NUMBER_WORDS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5}

UNSAID = {None, "", False}
"""Defaults that set nothing, and need no words."""


def keys_of(options: type[Any]) -> dict[str, str]:
    return dict(KEY.findall(inspect.cleandoc(options.__doc__ or "")))


def value(text: str) -> Any:
    return ast.literal_eval(text)


@pytest.mark.parametrize("options", [Options, AsyncOptions])
def test_docstrings_of_options_name_the_defaults(options: type[Any]) -> None:
    texts = keys_of(options)
    assert texts.keys() <= set(options.__annotations__)
    said = {name: SAID.search(" ".join(text.split())) for name, text in texts.items()}
    for name in texts:
        found, default = said[name], CLIENTS[name]
        if found is not None and found[1] != "one":
            assert value(found[1]) == default, name
        else:
            assert default in UNSAID, f"{name} does not name its default, {default!r}"


def test_docstrings_of_options_name_each_key() -> None:
    told = [name for options in (Options, AsyncOptions) for name in keys_of(options)]
    assert sorted(told) == sorted(CLIENTS)


LISTED = re.compile(r"^ +\| +(\w+)=(\S+) +\S", re.MULTILINE)
"""An option and its default, as help shows it among the methods of a class."""


@pytest.mark.parametrize("client", [Client, AsyncClient])
def test_help_lists_every_option_with_its_default(client: type[Any]) -> None:
    listed = LISTED.findall(pydoc.plaintext.document(client))
    expected = [*CLIENTS.items(), ("max_pause", MAX_PAUSE)]
    assert sorted(listed) == sorted((name, _as_listed(value)) for name, value in expected)


def _as_listed(value: Any) -> str:
    return repr(value).replace("'", '"')


@pytest.mark.parametrize("client", [Client, AsyncClient])
@pytest.mark.parametrize("method", ["execute", "read_many", "watch"])
def test_help_tells_what_methods_of_many_types_do(client: type[Any], method: str) -> None:
    text = pydoc.plaintext.document(getattr(client, method))
    assert re.search(r"\n    [A-Z].*\.\n[^$]*Args:", text), text


def options_of(cls: type[Any]) -> dict[str, Any]:
    """Return the arguments of a dataclass that have a default."""
    found = {}
    for each in fields(cls):
        if each.init and each.default_factory is not MISSING:
            found[each.name] = each.default_factory()
        elif each.init and each.default is not MISSING:
            found[each.name] = each.default
    return found


@pytest.mark.parametrize(
    ("heading", "expected"),
    [
        ("Clients", CLIENTS),
        ("Serial ports", SERIAL_DEFAULTS),
        ("Limits of servers and gateways", options_of(Limits)),
        ("Gateways", options_of(GatewayOptions)),
        ("Devices of a fleet", options_of(DeviceConfig)),
    ],
)
def test_the_page_of_defaults_is_what_the_code_has(heading: str, expected: Any) -> None:
    part = (DOCS / "defaults.md").read_text().partition(f"\n## {heading}\n")[2]
    rows = re.findall(r"^\| `(\w+)` \| `(.+?)` \|", part.partition("\n## ")[0], re.MULTILINE)
    assert {name: value(text) for name, text in rows} == dict(expected)
    assert len(rows) == len(expected)


def test_pages_name_the_default_timeout_and_the_serial_settings() -> None:
    seconds = f"{CLIENTS['timeout']:g} s"
    assert f"# {seconds} is the default" in (DOCS / "how-to" / "timeouts.md").read_text()
    usual = "{baudrate} {data_bits}{parity}{stop_bits}".format(**SERIAL_DEFAULTS)
    assert f"[{usual}](../defaults.md" in (DOCS / "how-to" / "serial-ports.md").read_text()


def test_the_page_of_register_maps_has_every_key_of_a_point() -> None:
    page = (DOCS / "how-to" / "register-maps.md").read_text()
    table = page.partition("| key | default | meaning |")[2].partition("\n\n")[0]
    firsts = [line.split("|")[1] for line in table.splitlines()[2:]]
    keys = [key for first in firsts for key in re.findall(r"`(\w+)`", first)]
    assert sorted(keys) == sorted(each.name for each in fields(Point) if each.init)


def test_pages_that_name_an_option_with_a_number_name_its_default() -> None:
    compared = set()
    for path in DOCS.rglob("*.md"):
        for words, option in NAMED.findall(" ".join(path.read_text().split())):
            numbers = [
                NUMBER_WORDS[each] if each in NUMBER_WORDS else float(each)
                for each in re.findall(r"\d+(?:\.\d+)?|\b(?:one|two|three|four|five)\b", words)
            ]
            if option in CLIENTS and numbers:
                assert CLIENTS[option] in numbers, f"{path.name}: {words}({option})"
                compared.add(option)
    assert "turnaround" in compared
