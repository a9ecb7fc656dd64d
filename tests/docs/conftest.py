"""What a document has when it runs."""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sybil import Example

from libmodbus_py import pdu
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
    with Home(tmp_path) as folder:
        yield folder
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
        path = home.folder / example.region.lexemes["file"]
        path.write_text(home.here(example.parsed))

    yield Examples(python, typed(of_console), typed(of_sh), file)
    shell.close()


@pytest.fixture
def run(home: Home, examples: Examples) -> Callable[[Path], None]:
    """Run a document from its beginning to its end."""

    def run_all(path: Path) -> None:
        document = read(path, examples)
        document.namespace["home"] = home  # for blocks that readers do not see
        for example in document.examples():
            example.evaluate()

    return run_all
