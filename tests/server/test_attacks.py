"""
Each attack against a server of its own: an innocent client loses nothing, gets only right values
and waits for few of the others' requests, and nothing of the attack is left.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from libmodbus_py import Device, Limits, Mapping, Server
from libmodbus_py.server.peer import READ_BYTES
from tests.simulation.attackers import Attackers, Innocent
from tests.simulation.stage import Stage
from tests.support import attacks
from tests.support.attacks import (
    ATTACKS,
    UNIT,
    Attack,
    AttackerProcess,
    ServerProcess,
    adu,
    descriptor_limit,
)
from tests.support.certificates import Papers

# What a server may grow by. 50 that never read leave 64 KiB of answers each, and what came in one
# turn.
MEMORY = 64 << 20

# How many of those that send something are enough: in a turn 128 connections are read.
SENDERS = 200

# The turns of the loop in which so many are read, and one for the answer.
TURNS = -(-SENDERS // 128) + 1


def others(attack: Attack) -> int:
    """
    How many requests of others are answered before the innocent's: what one turn reads of them,
    `READ_BYTES` of each of up to 128 connections.
    """
    return min(attack.connections, 128) * READ_BYTES // len(adu(b"\x63\1\2\3"))


def enough(attack: Attack) -> Attack:
    return replace(attack, connections=min(attack.connections, SENDERS)) if attack.sends else attack


@pytest.mark.parametrize(
    "attack", [*map(enough, ATTACKS)], ids=lambda attack: attack.name.replace(" ", "-")
)
def test_an_innocent_client_waits_for_few_of_the_others(
    stage: Stage, attack: Attack, tmp_path: Path
) -> None:
    """The innocent speaks TCP; an attack on TLS meets another endpoint of the same server."""
    server = Server(
        {UNIT: Device(Mapping(holding_registers=2000))},
        limits=Limits(max_connections=1500),
        security=Papers(tmp_path).server() if attack.scheme == "tls" else None,
    )
    urls = ["tcp://10.0.0.1:0", f"{attack.scheme}://10.0.0.1:0"]
    with server.background(*urls) as running, stage.talk(running.urls[0]) as client:
        innocent = Innocent(stage, client, lambda: server.statistics.requests)
        assert innocent.poll(5).turns == [0] * 5
        with Attackers(stage, attack, running.urls[1]) as attackers:
            assert stage.until(lambda: attackers.all_attack, 10)
            waited = innocent.poll(3, among=attackers)
        assert (attackers.sent > 0) == attack.sends
        assert max(waited.turns) <= TURNS
        assert max(waited.others) <= others(attack)
        assert waited.longest <= others(attack) + 1
        assert stage.until(lambda: server.statistics.connections == 1)
        assert innocent.poll(5).turns == [0] * 5


def test_an_innocent_client_of_the_system_loses_nothing() -> None:
    """The real copy of one attack, from a process of its own upon another."""
    attack = next(attack for attack in ATTACKS if attack.name == "50 that never read")
    with (
        descriptor_limit(),
        ServerProcess() as server,
        attacks.Innocent(server.port) as innocent,
        AttackerProcess(attack, server.attacked_port) as attackers,
    ):
        undisturbed = innocent.poll(0.05)
        descriptors, resident = server.descriptors(), server.resident()
        attackers.begin()
        attacked = innocent.poll(0.2, until=attackers.all_attack)
        grown = server.resident() - resident
        done = attackers.end()
        assert done.connected >= attack.connections
        for polled in (undisturbed, attacked):
            assert polled.requests > 0
            assert (polled.lost, polled.wrong) == (0, 0)
        assert grown < MEMORY
        assert server.has_descriptors(descriptors)
