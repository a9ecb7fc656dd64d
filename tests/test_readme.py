"""
The code in README.md and docs/guide.md runs, and gives what its comments say.
"""

from __future__ import annotations

import ast
import asyncio
import contextlib
import inspect
import io
import logging
import re
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType
from typing import Any

import pytest

import libmodbus_py
from libmodbus_py import Device, Mapping, Server, TcpContext, pdu
from libmodbus_py.cli.main import main

ROOT = Path(__file__).parents[1]


def blocks(file: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / file).read_text(), re.DOTALL)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def test_the_first_example_prints_what_it_says() -> None:
    (example,) = blocks("README.md")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(example.replace("1502", str(free_port())), {})
    assert printed.getvalue().splitlines() == [
        "[555, 0, 100]",
        "[[1711, 1214, 4109]]",
        "unit 17, function 6, WriteRegister(address=2449, value=999):"
        " illegal data address (exception 2)",
    ]


# --- the guide -----------------------------------------------------------------------------


@pytest.fixture
def names() -> Iterator[dict[str, Any]]:
    """What the reader of a block has already: a client, a device that has everything."""
    mapping = Mapping(1000, 1000, 10_000, 1000)
    device = Device(mapping, files={3: [0] * 100, 4: [0] * 100}, fifos={1246: [440, 4740]})
    registered = dict(pdu.REQUESTS)
    with Server(device).background("tcp://127.0.0.1:0") as running:
        port = int(running.urls[0].rpartition(":")[2])
        with TcpContext("127.0.0.1", port) as plc:
            yield {name: getattr(libmodbus_py, name) for name in libmodbus_py.__all__} | {
                "asyncio": asyncio,
                "dataclass": dataclass,
                "logging": logging,
                "url": running.urls[0],
                "plc": plc,
                "mapping": mapping,
                "device": device,
                "requests": [pdu.ReadHoldingRegisters(0, 10)] * 20,
                "refresh": print,
                "data": b"",
            }
    pdu.REQUESTS.clear()
    pdu.REQUESTS.update(registered)


def at_home(block: str, url: str) -> str:
    """Give a block with the addresses of this machine."""
    for there, here in {
        "tcp://192.0.2.10": url,
        "tcp://0.0.0.0:502": "tcp://127.0.0.1:0",
        ', "rtu:///dev/ttyUSB0?baudrate=19200"': "",
        ".serve_forever(": ".background(",
        "1502": str(free_port()),
    }.items():
        block = block.replace(there, here)
    return block


class Comparing(ast.NodeTransformer):
    """Turns ``asked()  # [1]`` into a comparison."""

    def __init__(self, source: str) -> None:
        self._lines = source.splitlines()
        self.compared = 0

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        try:
            comment = self._lines[node.lineno - 1].split("  # ")[1]
            expected = ast.parse(comment, mode="eval").body
            result = ast.literal_eval(expected)
        except (IndexError, SyntaxError, ValueError):
            return node
        if "..." in comment or not isinstance(result, list | dict | bytes):
            return node  # it tells less than all, or a function code
        self.compared += 1
        call = ast.Call(ast.Name("must_equal", ast.Load()), [node.value, expected], [])
        return ast.fix_missing_locations(ast.copy_location(ast.Expr(call), node))


def must_equal(found: object, expected: object) -> None:
    assert found == expected


def compiled(block: str) -> tuple[CodeType, int]:
    comparing = Comparing(block)
    tree = comparing.visit(ast.parse(block))
    flags = ast.PyCF_ALLOW_TOP_LEVEL_AWAIT
    return compile(tree, "guide", "exec", flags=flags), comparing.compared


GUIDE = blocks("docs/guide.md")


@pytest.mark.parametrize("block", GUIDE, ids=range(len(GUIDE)))
def test_code_of_the_guide_runs(
    block: str, names: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, _ = compiled(at_home(block, names["url"]))
    with contextlib.redirect_stdout(io.StringIO()):
        if ".pem" in block:
            monkeypatch.chdir(tmp_path)
            assert main(["certificates", "."]) == 0
        result = eval(code, names | {"must_equal": must_equal})
        if inspect.iscoroutine(result):
            asyncio.run(result)


def test_the_comments_of_the_guide_are_compared() -> None:
    """Else the test above would prove less than it says."""
    assert sum(compiled(block)[1] for block in GUIDE) >= 6


@pytest.mark.parametrize(
    "file", ["README.md", *sorted(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]
)
def test_links_lead_somewhere(file: str) -> None:
    text = (ROOT / file).read_text()
    links = re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", text)
    missing = [path for path, _ in links if path and not ((ROOT / file).parent / path).exists()]
    assert missing == []
    headings = {
        re.sub(r"[^\w\- ]", "", line.lstrip("# ").lower()).replace(" ", "-")
        for line in text.splitlines()
        if line.startswith("#")
    }
    assert [heading for path, heading in links if not path and heading not in headings] == []
