"""
What a document has when it runs.
"""

from __future__ import annotations

import asyncio
import importlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from sybil import Example

import libmodbus_py
from libmodbus_py import Context, pdu
from tests.docs.documents import ROOT, Examples, read
from tests.docs.home import Home
from tests.docs.python_blocks import run_python
from tests.docs.shell_blocks import Command, Shell, of_console, of_sh


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Home]:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    registered = dict(pdu.REQUESTS)
    wire = logging.getLogger("libmodbus_py.wire")
    level = wire.level
    with Home(tmp_path) as made:
        yield made
    pdu.REQUESTS.clear()
    pdu.REQUESTS.update(registered)
    wire.setLevel(level)


@pytest.fixture
def examples(home: Home) -> Iterator[Examples]:
    shell = Shell(home.folder, home.here, home.there)

    def typed(commands: Callable[[str], Iterator[Command]]) -> Callable[[Example], None]:
        def evaluate(example: Example) -> None:
            for command in commands(example.parsed):
                try:
                    shell.type(command)
                except AssertionError as error:
                    error.add_note(f"{example.path}:{example.line + command.line}: {command.text}")
                    raise

        return evaluate

    def python(example: Example) -> None:
        source = home.here(example.parsed).replace('.serve_forever("', '.background("')
        run_python(example, source, home.there)

    def file(example: Example) -> None:
        path = home.folder / example.region.lexemes["title"]
        path.write_text(home.here(example.parsed))

    yield Examples(python, typed(of_console), typed(of_sh), file)
    shell.close()


def names(home: Home) -> dict[str, Any]:
    """Return the names that a block may use without importing them."""
    plc = home.at_end.enter_context(Context.from_url(home.url))
    known: dict[str, Any] = {}
    for module in ("libmodbus_py.listen", "libmodbus_py.page", "libmodbus_py.scan"):
        known |= vars(importlib.import_module(module))
    top = [*libmodbus_py.__all__, "framing", "pdu", "values"]
    known |= {name: getattr(libmodbus_py, name) for name in top}
    return known | {
        "asyncio": asyncio,
        "at_end": home.at_end,
        "dataclass": dataclass,
        "device": home.device,
        "home": home,
        "logging": logging,
        "mapping": home.mapping,
        "plc": plc,
        "url": home.url,
    }


@pytest.fixture
def run(home: Home, examples: Examples) -> Callable[[Path], None]:
    """Run a document from its beginning to its end."""

    def run_all(path: Path) -> None:
        document = read(path, examples)
        document.namespace |= names(home)
        for example in document.examples():
            example.evaluate()

    return run_all
