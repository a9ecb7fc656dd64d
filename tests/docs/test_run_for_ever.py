"""Loops of the page about programs that run for ever go on while a device is down."""

import asyncio
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from random import SystemRandom

import pytest
from sybil import Document

from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.maps.items import NamedValues
from tests.docs.documents import ROOT, blocks

PAGE = ROOT / "docs" / "how-to" / "run-for-ever.md"

randrange = SystemRandom().randrange  # tests may seed the usual generator

# At an address of this process alone, so that nobody else takes the port while nothing listens. At
# random: containers that share a network have processes of the same number.
URL = f"tcp://127.{64 + randrange(128)}.{randrange(256)}.{randrange(256)}:11502"

BREAK = re.compile(r"break  # .*")

LOOPS = [
    block.lexemes["source"]
    for block in blocks(Document(PAGE.read_text(), str(PAGE)))
    if BREAK.search(block.lexemes["source"])
]


class Plant:
    """A device that is down at first, and fails once."""

    def __init__(self) -> None:
        self._device = Device(Mapping(coils=8, holding_registers={100: [555, 0]}))
        self._served = ExitStack()
        self._awaited = iter(self._course())
        self._is_up = next(self._awaited)

    def _course(self) -> Iterator[bool]:
        """Yield whether the device is up, each time that the loop has seen the state before."""
        yield False
        self._served.enter_context(Server(self._device).background(URL))
        yield True
        self._served.close()
        yield False
        self._served.enter_context(Server(self._device).background(URL))
        yield True
        self._served.close()

    def is_over(self, values: NamedValues[str, object]) -> bool:
        """Say after each poll whether the loop has seen all that happened."""
        if bool(values.failed) == self._is_up:
            return False
        is_up = next(self._awaited, None)
        self._is_up = bool(is_up)
        return is_up is None


@pytest.mark.parametrize("source", LOOPS, ids=["blocking", "asyncio"])
def test_a_loop_continues_after_its_device_failed(source: str, capsys: pytest.CaptureFixture[str]):
    plant = Plant()
    source = re.sub(r'"tcp://[^"]*"', repr(URL), source).replace("every=1", "every=0.02")
    exec(BREAK.sub("if plant.is_over(values): break", source), {"plant": plant})
    printed = capsys.readouterr().out.splitlines()
    lines = [re.sub(r"( \[|:).*", "", line) for line in printed if "valves" not in line]
    changes = [line for line, before in zip(lines, ["", *lines], strict=False) if line != before]
    assert changes == ["no level", "level", "no level", "level"]
    assert "cannot connect" in printed[0]


def test_the_loops_have_ten_lines() -> None:
    assert len(LOOPS) == 2
    for source in LOOPS:
        loop = source[re.search(r"plc = ", source).start() :].partition("\n\n")[0]  # type: ignore[union-attr]
        assert len(loop.splitlines()) + 1 <= 10


def enter_blocking(url: str) -> None:
    with Client(url):
        pass


def enter_asyncio(url: str) -> None:
    async def enter() -> None:
        async with AsyncClient(url):
            pass

    asyncio.run(enter())


@pytest.mark.parametrize("enter", [enter_blocking, enter_asyncio])
def test_entering_a_with_block_raises_while_a_device_is_down(enter: Callable[[str], None]) -> None:
    with pytest.raises(ModbusConnectionError, match="cannot connect"):
        enter(URL)


def test_after_an_error_the_next_request_connects_again() -> None:
    async def ask(url: str) -> list[int]:
        plc = AsyncClient(url, timeout=5)
        with pytest.raises(ModbusConnectionError):
            await plc.read_holding_registers(100, 1)
        async with Server(Device(Mapping(holding_registers={100: [555]}))).serving(url):
            registers = await plc.read_holding_registers(100, 1)
            await plc.close()
        return registers

    assert asyncio.run(ask(URL)) == [555]
    plc = Client(URL)
    with pytest.raises(ModbusConnectionError):
        plc.read_holding_registers(100, 1)
    with Server(Device(Mapping(holding_registers={100: [555]}))).background(URL):
        assert plc.read_holding_registers(100, 1) == [555]
        plc.close()
