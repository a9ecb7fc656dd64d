"""
Where a document runs: a folder, and a device that answers.

At 192.0.2.10 and /dev/ttyUSB0 is a server that has everything, all zero; /dev/ttyUSB1 and
/dev/ttyUSB2 are the two ends of a cable.
"""

import contextlib
import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from sybil import Example

from libmodbus_py import Device, Mapping, Server, pdu
from libmodbus_py.tools.testing.wires import SerialWire
from tests.docs.documents import ROOT, Examples, read
from tests.docs.namespace import plug_in
from tests.docs.python_blocks import run_python
from tests.docs.shell_blocks import Command, Shell, of_console, of_sh


class Home:
    """
    `folder`: where files are, and commands run. `at_end`: what is undone when the document ends;
    `device, mapping`: who answers at 192.0.2.10 and /dev/ttyUSB0.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.at_end = ExitStack()
        self.mapping = Mapping(65536, 65536, 65536, 65536)
        self.device = Device(
            self.mapping,
            files={number: [0] * 10_000 for number in range(1, 11)},
            fifos={1246: [440, 4740]},
        )

    def __enter__(self) -> Self:
        self.at_end.enter_context(contextlib.chdir(self.folder))
        Path("examples").symlink_to(ROOT / "examples")
        self.at_end.enter_context(_usual_state())
        line, cable = (self.at_end.enter_context(SerialWire()) for _ in range(2))
        served = Server(self.device).background("tcp://192.0.2.10", f"rtu://{line.server}")
        self.at_end.enter_context(served)
        ends = {"USB0": line.client, "USB1": cable.client, "USB2": cable.server}
        self.at_end.enter_context(plug_in({f"/dev/tty{name}": end for name, end in ends.items()}))
        return self

    def __exit__(self, *_: object) -> None:
        self.at_end.close()

    def name(self, text: str) -> str:
        """Put the name of the folder into what was printed."""
        return text.replace(str(self.folder), ".")


@contextlib.contextmanager
def _usual_state() -> Iterator[None]:
    """Keep what a document may change for its process."""
    registered = dict(pdu.REQUESTS)
    wire = logging.getLogger("libmodbus_py.wire")
    level = wire.level
    yield
    pdu.REQUESTS.clear()
    pdu.REQUESTS.update(registered)
    wire.setLevel(level)


def run_document(path: Path, folder: Path) -> None:
    """Run a document from its beginning to its end, in an empty folder."""
    with Home(folder) as home:
        shell = home.at_end.enter_context(contextlib.closing(Shell(folder, home.name)))
        document = read(path, _examples(home, shell))
        document.namespace["home"] = home  # for blocks that readers do not see
        for example in document.examples():
            example.evaluate()


def _examples(home: Home, shell: Shell) -> Examples:
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
        source = example.parsed.replace('.serve_forever("', '.background("')
        run_python(example, source, home.name)

    def file(example: Example) -> None:
        (home.folder / example.region.lexemes["file"]).write_text(example.parsed)

    return Examples(python, typed(of_console), typed(of_sh), file)
