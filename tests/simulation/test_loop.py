"""The clock, the loop and the network of the simulated world."""

import asyncio
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, Fault, Fleet, Mapping, ModbusTimeoutError, Server
from libmodbus_py.fleet import Journal
from libmodbus_py.services.fleet.journal import journal
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from tests.services.fleet.fleets import Peer, meter, simulated_run
from tests.services.fleet.journal.journals import Inline
from tests.support.attacks import READ_ONE, adu
from tests.support.cases import each_case
from tests.support.lan_server import ANSWER_ONE, server_on

from .events import START
from .lan import Lan
from .loop import VirtualLoop
from .network import Network
from .runs import options_of, play
from .scenarios import SCENARIOS

# The scenarios without a whole plant, which takes minutes.
QUICK = [scenario for scenario in SCENARIOS if scenario != "plant"]


@pytest.fixture
def early(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let timers end a microsecond before their time."""
    monkeypatch.setattr(VirtualLoop, "early", 1e-6)


def at(time: float) -> Network:
    network = Network()
    network.events.now = time
    return network


@each_case("start", [0.0, 1000.0, 2.0**24 + 0.1, 1e9 + 1 / 3, 2.0**40])
def test_no_timer_ends_before_its_time_or_more_than_a_step_later(start: float) -> None:
    network = at(start)

    async def wait() -> None:
        loop = asyncio.get_running_loop()
        for number in range(1, 2000):
            due = loop.time() + number / 7000
            rung = loop.create_future()
            loop.call_at(due, rung.set_result, None)
            await rung
            assert due <= loop.time() <= math.nextafter(due, math.inf)

    network.run(wait)


@pytest.mark.parametrize("scenario", QUICK)
def test_worlds_keep_their_rules_if_timers_end_early(scenario: str, early: None) -> None:
    play(replace(options_of(1), scenario=scenario, seconds=20.0))


@pytest.mark.parametrize("rate", [0.3, 7, 150])
def test_a_server_delays_what_exceeds_a_rate_if_timers_end_early(early: None, rate: float) -> None:
    count = int(rate) + 10
    with (
        Lan() as lan,
        server_on(lan, requests_per_second=rate) as server,
        server.connect() as eager,
    ):
        for number in range(count):
            eager.sendall(adu(READ_ONE, number))
            eager.receive(len(ANSWER_ONE) + 7)
        assert server.counts(requests=count)
        assert lan.now - START == pytest.approx((count - 1 - max(1, rate)) / rate, abs=0.05)


def test_a_journal_is_forced_onto_the_disk_once_after_a_poll_if_timers_end_early(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, early: None
) -> None:
    monkeypatch.setattr(journal, "WriterThread", Inline)
    calls: list[str] = []
    for name in ("write_polls", "force"):
        patch_with_note(monkeypatch, name, calls)

    async def poll() -> None:
        async with Peer() as peer:
            device = meter("a", peer.url, interval=10)
            async with Fleet([device], outputs=[], journal=Journal(tmp_path / "fleet.db")):
                await asyncio.sleep(95)
                writes, forces = calls.count("write_polls"), calls.count("force")
        # A poll is written, forced, and what that was is noted.
        assert 9 <= forces <= 10
        assert writes <= 2 * forces + 1

    simulated_run(poll())


def patch_with_note(patch: pytest.MonkeyPatch, name: str, calls: list[str]) -> None:
    method = getattr(JournalFile, name)

    def note(*arguments: Any) -> Any:
        calls.append(name)
        return method(*arguments)

    patch.setattr(JournalFile, name, note)


READ = bytes.fromhex("0001 0000 0006 11 03 0002 0001")


def test_in_a_simulated_network_time_passes_only_while_the_test_waits() -> None:
    late = {None: [Fault("delay", seconds=500)]}
    server = Server({17: Device(Mapping(holding_registers={2: [502]}))}, faults=late)
    with Lan() as lan, server.background("tcp://10.0.0.1:0") as running:
        with lan.client(running.urls[0], "10.0.0.2") as client:
            client.sendall(READ)
            before = lan.now
            lan.pass_time(0)
            assert lan.now == before
            assert client.recv(100)[-2:] == struct.pack(">H", 502)
            assert lan.now - before == pytest.approx(500, abs=0.001)
        with (
            Client(running.urls[0], unit=17, timeout=100) as plc,
            pytest.raises(ModbusTimeoutError),
        ):
            plc.read_holding_registers(2, 1)
        assert lan.now - before >= 600
