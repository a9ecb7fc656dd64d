"""
The pages for who comes from a peer: pairs of programs, which do the same, and tables of its words.

That both sides run, and give what they say, is seen where all documents run.
"""

import ast
import asyncio
import contextlib
import importlib.util
import inspect
import io
import re
import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import minimalmodbus
import pylibmodbus
import pymodbus.client
import pymodbus.exceptions
import pymodbus.server
import pyModbusTCP.client
import pyModbusTCP.constants
import pytest
import serial
from pymodbus.client.mixin import ModbusClientMixin
from sybil import Document

from libmodbus_py import Client, Device, Mapping, ModbusError, Server, errors, values
from libmodbus_py.tools.testing.wires import SerialWire
from tests.docs.conftest import Isolated
from tests.docs.documents import ROOT, blocks
from tests.docs.home import Home
from tests.docs.python_blocks import (
    Comparing,
    comments_of,
    is_value,
    matches,
    must_equal,
    must_print,
)
from tests.support.cases import each_case
from tests.support.peers import FakeServer

FOLDER = ROOT / "docs" / "coming-from"

# The fewest pairs of each page; mbpoll.md has a session, and tables of options.
PAIRS = {"pymodbus": 6, "others": 4}

PAIR = '<div class="grid" markdown>'
LINES = re.compile(r"takes (\d+) lines with \w+ and (\d+) with libmodbus-py")


@dataclass(frozen=True)
class Pair:
    before: str
    theirs: str
    ours: str


def pairs(page: str) -> Iterator[Pair]:
    before, *parts = (FOLDER / f"{page}.md").read_text().split(PAIR)
    for part in parts:
        inside, _, after = part.partition("</div>")
        theirs, ours = (block.lexemes["source"] for block in blocks(Document(inside, page)))
        yield Pair(before, theirs, ours)
        before = after


def programs() -> dict[str, Pair]:
    """Return the pairs whose lines the pages count: the first of each peer."""
    pairs_ = [pair for page in (*PAIRS, "mbpoll") for pair in pairs(page)]
    counted = {match[0]: pair for pair in pairs_ if (match := LINES.search(pair.before))}
    return {re.findall(r"with (\w+) and", text)[0]: entry for text, entry in counted.items()}


PROGRAMS = programs()


def outputs(source: str) -> list[object]:
    """The values that comments name; a value alone and a list of it are one to readers."""
    texts = [text for text in comments_of(source).values() if is_value(text)]
    values = [ast.literal_eval(text) for text in texts]
    return [value[0] if isinstance(value, list) and len(value) == 1 else value for value in values]


@pytest.mark.parametrize("page", PAIRS)
def test_both_programs_of_a_pair_print_the_same(page: str) -> None:
    rows = list(pairs(page))
    assert len(rows) >= PAIRS[page]
    for row in rows:
        assert outputs(row.theirs)[-1] == outputs(row.ours)[-1], row.ours
        assert "libmodbus_py" not in row.theirs


def test_each_page_begins_with_a_program_for_both_packages() -> None:
    assert list(PROGRAMS) == ["pymodbus", "pylibmodbus", "minimalmodbus", "pyModbusTCP", "mbpoll"]


@each_case("peer", PROGRAMS)
def test_the_lines_of_both_programs_are_counted(peer: str) -> None:
    each = PROGRAMS[peer]
    counts = [len(list(filter(str.strip, text.splitlines()))) for text in (each.theirs, each.ours)]
    assert counts == [int(text) for text in LINES.search(each.before).groups()]  # type: ignore[union-attr]


@pytest.mark.parametrize("peer", [program for program in PROGRAMS if program != "mbpoll"])
def test_both_programs_print_the_comments(peer: str, tmp_path: Path, isolated: Isolated) -> None:
    """Each print with a comment is reached, by theirs and by ours."""
    isolated(compare_prints, peer, tmp_path)


def compare_prints(peer: str, folder: Path) -> None:
    page = "pymodbus" if peer == "pymodbus" else "others"
    with Home(folder) as home:
        exec(next(blocks_that_readers_do_not_see(page)), {"home": home})
        for source in (PROGRAMS[peer].theirs, PROGRAMS[peer].ours):
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(source, {})
            printed, comments = output.getvalue().splitlines(), [*comments_of(source).values()]
            assert len(printed) == len(comments), printed
            for text, line in zip(comments, printed, strict=True):
                assert matches(text, line), line


def blocks_that_readers_do_not_see(page: str) -> Iterator[str]:
    document = Document((FOLDER / f"{page}.md").read_text(), page)
    for region in blocks(document):
        if document.text[region.start : region.start + 4] == "<!--":
            yield region.lexemes["source"]


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.md")), ids=lambda path: path.stem)
def test_each_page_names_the_kinds_of_errors(path: Path) -> None:
    direct = [name for name in errors.__all__ if ModbusError in getattr(errors, name).__bases__]
    kinds = {*direct, "ModbusError", "IllegalDataAddress"}
    assert kinds <= set(re.findall(r"`(\w+)`", path.read_text()))


@pytest.fixture
def silent() -> Iterator[int]:
    """Return the port of a listener that answers nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


@pytest.fixture
def served() -> Iterator[int]:
    """Return the port of a device without cells from 8 on."""
    with Server(Device(Mapping(holding_registers=8))).background("tcp://127.0.0.1:0") as running:
        yield int(running.urls[0].rpartition(":")[2])


def ask_as_pymodbus(port: int, timeout: float) -> str:
    client = pymodbus.client.ModbusTcpClient("127.0.0.1", port=port, timeout=timeout, retries=0)
    try:
        client.connect()
        answer = client.read_holding_registers(100, count=1)
        return f"isError() {answer.exception_code}" if answer.isError() else ""
    except pymodbus.exceptions.ModbusException as error:
        return type(error).__name__
    finally:
        client.close()


def ask_as_pylibmodbus(port: int, timeout: float) -> str:
    client = pylibmodbus.ModbusTcp("127.0.0.1", port)
    try:
        client.set_response_timeout(timeout)
        client.connect()
        client.read_registers(100, 1)
    except Exception as error:
        return f"{type(error).__name__} {type(error.args[0]).__name__}"
    finally:
        client.close()
    return ""


def ask_as_pymodbustcp(port: int, timeout: float) -> str:
    client = pyModbusTCP.client.ModbusClient("127.0.0.1", port, timeout=timeout)
    assert client.read_holding_registers(100, 1) is None
    refused = client.last_except
    names = vars(pyModbusTCP.constants).items()
    (name,) = [row for row, code in names if row[:3] == "MB_" and code == client.last_error]
    client.close()
    return f"last_except {refused}" if refused else name


def ask_as_libmodbus_py(port: int, timeout: float) -> str:
    try:
        with Client(f"tcp://127.0.0.1:{port}", timeout=timeout) as plc:
            plc.read_holding_registers(100, 1)
    except ModbusError as error:
        return type(error).__name__
    return ""


@pytest.mark.parametrize(
    ("ask", "refused", "silence", "damaged", "absent"),
    [
        (ask_as_pymodbus, "isError() 2", *["ModbusIOException"] * 2, "ConnectionException"),
        (ask_as_pylibmodbus, *["Exception bytes"] * 4),
        (ask_as_pymodbustcp, "last_except 2", "MB_TIMEOUT_ERR", "MB_RECV_ERR", "MB_CONNECT_ERR"),
        (
            ask_as_libmodbus_py,
            *("IllegalDataAddress", "ModbusTimeoutError", "FrameError", "ModbusConnectionError"),
        ),
    ],
)
def test_errors_over_tcp_are_those_of_the_tables(
    ask, refused, silence, damaged, absent, served: int, silent: int
) -> None:
    with FakeServer(lambda request: [b"HTTP/1.1 400 Bad Request\r\n\r\n"]) as server:
        assert ask(server.port, 1) == damaged
    assert [ask(served, 10), ask(silent, 0.1), ask(1, 10)] == [refused, silence, absent]


@each_case(
    ("ask", "kind"),
    [
        (lambda plc: plc.read_coils(0, count=2001), ValueError),
        (lambda plc: plc.read_coils(70_000), ValueError),
        (lambda plc: plc.write_register(0, 70_000), struct.error),
        (lambda plc: plc.convert_to_registers("x", plc.DATATYPE.BITS), TypeError),
    ],
)
def test_wrong_arguments_raise_what_the_table_of_pymodbus_says(ask: Any, kind: Any) -> None:
    with Server(Device(Mapping(coils=8))).background("tcp://127.0.0.1:0") as running:
        port = int(running.urls[0].rpartition(":")[2])
        with pymodbus.client.ModbusTcpClient("127.0.0.1", port=port) as plc, pytest.raises(kind):
            ask(plc)


def test_errors_of_minimalmodbus_are_those_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    # It keeps ports by their paths, which other tests have had with other settings.
    monkeypatch.setattr(minimalmodbus, "_serialports", {})
    with SerialWire() as wire:
        instrument = minimalmodbus.Instrument(wire.client, 17)
        port = instrument.serial
        assert (port.timeout, port.baudrate, port.parity, port.stopbits) == (0.05, 19200, "N", 1)
        with pytest.raises(minimalmodbus.NoResponseError):
            instrument.read_register(0)
        with Server(Device(Mapping(holding_registers=8))).background(
            f"rtu://{wire.server}?parity=N"
        ):
            instrument.serial.timeout = 3  # it waits for the bytes that a refusal lacks
            with pytest.raises(minimalmodbus.SlaveReportedException):
                instrument.read_register(100)
        instrument.serial.close()
    with pytest.raises(serial.SerialException):
        minimalmodbus.Instrument("/nonexistent/tty", 17)
    assert issubclass(minimalmodbus.NoResponseError, minimalmodbus.ModbusException)
    assert issubclass(minimalmodbus.InvalidResponseError, minimalmodbus.ModbusException)
    assert issubclass(minimalmodbus.ModbusException, OSError)


def parameters(*callables: Any) -> dict[str, Any]:
    """Return the defaults of all arguments, by name; of several with one name, the last."""
    signatures = [inspect.signature(callable_).parameters for callable_ in callables]
    return {name: entry.default for names in signatures for name, entry in names.items()}


PEERS = {
    "pymodbus": parameters(
        pymodbus.server.ModbusTcpServer,
        pymodbus.client.ModbusSerialClient,
        pymodbus.client.AsyncModbusTcpClient,
        ModbusClientMixin.read_coils,
    ),
    "others": parameters(
        pylibmodbus.ModbusRtu, minimalmodbus.Instrument, pyModbusTCP.client.ModbusClient
    ),
}


# What the tables show with another value than the default.
SHOWN = ("framer", "ignore_missing_devices", "auto_close", "debug", "max_pause", "trace")


def option_rows(page: str) -> list[list[str]]:
    _, _, text = (FOLDER / f"{page}.md").read_text().partition("| options")
    lines = text.partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.parametrize("page", PEERS)
def test_the_options_of_peers_and_their_defaults_exist(page: str) -> None:
    """Ours are compared with the code where the page of defaults is; their values here."""
    rows = option_rows(page)
    assert len(rows) >= 6
    for *theirs, _ours in rows:
        for name, value in re.findall(r"`(\w+)=([^`]+)`", " ".join(theirs)):
            default = PEERS[page][name]
            assert name in SHOWN or default == ast.literal_eval(value), (name, default)


def test_options_without_an_equivalent_exist() -> None:
    page = (FOLDER / "pymodbus.md").read_text()
    (names,) = re.findall(r"^No equivalent: (.*)\n", page, re.MULTILINE)
    assert {*re.findall("`(.*?)`", names)} <= PEERS["pymodbus"].keys()
    assert pylibmodbus.ModbusTcp("127.0.0.1", 502).get_response_timeout() == 0.5


@pytest.mark.parametrize("page", PEERS)
def test_our_options_and_their_defaults_are_those_of_the_page_of_defaults(page: str) -> None:
    text = (ROOT / "docs" / "defaults.md").read_text().partition("\n## Limits")[0]
    defaults = dict(re.findall(r"^\| `(\w+)` \| `([^`]+)` \|", text, re.MULTILINE))
    pairs = [pair for row in option_rows(page) for pair in re.findall(r"`(\w+)=([^`]+)`", row[-1])]
    assert len(pairs) >= 4
    for name, value in pairs:
        if name in defaults and name not in SHOWN:
            assert defaults[name] == value


def test_bits_of_pymodbus_are_bits16_with_the_order_badc() -> None:
    registers = range(0, 65536, 13)
    theirs = ModbusClientMixin.convert_from_registers(
        list(registers), ModbusClientMixin.DATATYPE.BITS
    )
    ours = values.value_type("bits16", order="BADC")
    assert theirs == [bit for register in registers for bit in ours.decode([register])]
    switches = [True] + [False] * 14 + [True]
    assert ours.encode(switches) == ModbusClientMixin.convert_to_registers(
        switches, ModbusClientMixin.DATATYPE.BITS
    )


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return replace_pymodbus(monkeypatch)


def replace_pymodbus(patch: pytest.MonkeyPatch) -> ModuleType:
    """Put examples/pymodbus_names.py in the place of pymodbus, as its docstring says."""
    specification = importlib.util.spec_from_file_location(
        "pymodbus_names", ROOT / "examples" / "pymodbus_names.py"
    )
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    for name in ("pymodbus", "pymodbus.client", "pymodbus.exceptions"):
        patch.setitem(sys.modules, name, module)
    return module


def test_programs_for_pymodbus_give_the_same_with_its_names(
    tmp_path: Path, isolated: Isolated
) -> None:
    """Those of the page: with errors, on a serial line, and with asyncio."""
    isolated(run_with_names, tmp_path)


def run_with_names(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as patch, Home(folder) as home:
        replace_pymodbus(patch)
        exec(next(blocks_that_readers_do_not_see("pymodbus")), {"home": home})
        for pair in [*pairs("pymodbus")][:3]:
            tree = Comparing(pair.theirs).visit(ast.parse(pair.theirs))
            checks = {"must_equal": must_equal, "must_print": must_print(str)}
            exec(compile(tree, "program", "exec"), checks)


def test_connected_has_the_values_that_pymodbus_gives_it(module: ModuleType, served: int) -> None:
    absent = module.ModbusTcpClient("127.0.0.1", port=1, retries=0)
    assert (absent.connect(), absent.connected) == (False, False)
    client = module.ModbusTcpClient("127.0.0.1", port=served)
    assert (client.connected, client.connect(), client.connected) == (False, True, True)
    client.close()
    assert not client.connected
    client.write_registers(1, [7, 8], slave=17)  # connects again
    answer = client.read_holding_registers(1, count=2, slave=17)
    assert (answer.isError(), answer.registers) == (False, [7, 8])
    refused = client.read_holding_registers(100, count=1)
    assert (refused.isError(), refused.exception_code, refused.registers) == (True, 2, [])
    client.close()


async def test_asyncio_programs_close_without_await(module: ModuleType, served: int) -> None:
    client = module.AsyncModbusTcpClient("127.0.0.1", port=served)
    assert await client.connect()
    assert client.connected
    client.close()
    assert not client.connected
    assert await client.connect()
    assert (await client.read_holding_registers(0, count=1)).registers == [0]
    client.close()
    await asyncio.sleep(0.01)
    absent = module.AsyncModbusTcpClient("127.0.0.1", port=1)
    assert not await absent.connect()


def test_silence_raises_the_errors_of_the_pymodbus_names(module: ModuleType, silent: int):
    client = module.ModbusTcpClient("127.0.0.1", port=silent, timeout=0.05, retries=0)
    with pytest.raises(module.ModbusIOException):
        client.read_coils(0)
    client.close()
