"""The tables of options for who comes from another tool: each option of ours exists."""

import errno
import itertools
import re
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sybil import Document

from libmodbus_py.cli.ask.items import TABLE_WORDS
from libmodbus_py.cli.commands import COMMANDS, parser_of
from libmodbus_py.low_level import ffi, lib
from libmodbus_py.ports.schemes import SCHEMES
from libmodbus_py.protocol.words import order_named, table_named, type_named
from tests.docs.conftest import Isolated
from tests.docs.documents import ROOT, blocks
from tests.docs.shell_blocks import Shell, of_console

PAGE = ROOT / "docs" / "coming-from" / "mbpoll.md"

TOOLS = ("mbpoll", "modpoll", "modbus-cli", "QModMaster")


def rows(tool: str) -> Iterator[tuple[str, list[str]]]:
    """Yield what stands in the two columns of a table: their text, and our commands."""
    part = PAGE.read_text().partition(f"\n## {tool}\n")[2].partition("\n## ")[0]
    for line in part.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("|") and not set(line) <= set("|-: ") and len(cells) == 2:
            yield cells[0], re.findall("`([^`]+)`", cells[1])


@pytest.mark.parametrize("tool", TOOLS)
def test_every_option_of_ours_exists(tool: str) -> None:
    flags = {*parser_of("read").flags, *parser_of("write").flags}
    options = list(rows(tool))
    assert len(options) >= 8
    for theirs, ours in options:
        for words in ours:
            for word in words.split():
                if word.startswith("-") and not word[1:].isdigit():
                    assert word in flags, (theirs, word)


@pytest.mark.parametrize("tool", TOOLS)
def test_every_word_of_this_package_in_the_tables_exists(tool: str) -> None:
    names = {*COMMANDS, *TABLE_WORDS, *(f"{scheme}://" for scheme in SCHEMES)}
    for _, ours in rows(tool):
        for words in ours:
            first = words.split()[0]
            if first.islower() and first.isalnum():
                is_known = first in names or table_named(first) or type_named(first)
                assert is_known or order_named(first), words


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_the_session_is_the_same_with_mbpoll(tmp_path: Path, isolated: Isolated) -> None:
    """The server of the page, and then both sessions with it."""
    sources = [
        str(block.lexemes["source"]) for block in blocks(Document(PAGE.read_text(), str(PAGE)))
    ]
    _, theirs, ours = sources[:3]
    assert "mbpoll" in theirs
    assert "libmodbus-py read" in ours
    isolated(type_blocks, sources[:3], tmp_path)


def type_blocks(sources: list[str], folder: Path) -> None:
    with closing(Shell(folder, str)) as shell:
        for command in itertools.chain.from_iterable(map(of_console, sources)):
            shell.type(command)


def test_messages_of_mbpoll_are_those_of_libmodbus() -> None:
    """It prints what modbus_strerror returns for errno."""
    numbers = (lib.EMBXILADD, errno.ETIMEDOUT, lib.EMBBADCRC, lib.EMBBADDATA)
    table = PAGE.read_text().partition("| message of mbpoll")[2].partition("\n\n")[0]
    for number in numbers:
        assert f"`{ffi.string(lib.modbus_strerror(number)).decode()}`" in table
