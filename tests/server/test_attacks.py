"""
Each attack against a server of its own: an innocent client loses nothing and gets only
right values, and nothing of the attack is left. Times are noted, not judged.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.attacks import (
    ATTACKS,
    Attack,
    AttackerProcess,
    Innocent,
    Polled,
    ServerProcess,
    descriptor_limit,
)

# They are for whoever asks for a report, in whatever format.
pytestmark = pytest.mark.filterwarnings("ignore:record_property is incompatible")

Record = Callable[[str, object], None]

# What the server may grow by. 1000 connections take 3 MB; 50 that never read leave 64 KiB
# of answers each, and what came in one turn; 1000 half-open handshakes 50 kB each.
MEMORY = 64 << 20


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name.replace(" ", "-"))
def test_an_innocent_client_loses_nothing(
    attack: Attack, record_property: Record, tmp_path: Path
) -> None:
    papers = attack.papers(tmp_path)
    with (
        descriptor_limit(),
        ServerProcess(papers=papers, attacked=attack.scheme) as server,
        Innocent(server.port, papers) as innocent,
        AttackerProcess(attack, server.attacked_port) as attackers,
    ):
        undisturbed = innocent.poll(0.3)
        descriptors, resident = server.descriptors(), server.resident()
        attackers.begin()
        attacked = innocent.poll(1, until=attackers.all_attack)
        grown = server.resident() - resident
        done = attackers.end()

        assert done.connected >= attack.connections
        assert (done.sent > 0) == attack.sends
        for polled in (undisturbed, attacked):
            assert polled.requests > 0
            assert (polled.lost, polled.wrong) == (0, 0)
        assert grown < MEMORY
        assert server.has_descriptors(descriptors)
        recovered = innocent.poll(0.1)
        assert (recovered.lost, recovered.wrong) == (0, 0)
        with Innocent(server.port, papers) as newcomer:
            assert newcomer.poll(0.02).wrong == 0
    note(record_property, undisturbed, attacked)


def note(record_property: Record, undisturbed: Polled, attacked: Polled) -> None:
    record_property("worst undisturbed, ms", round(undisturbed.worst * 1000, 2))
    record_property("worst under attack, ms", round(attacked.worst * 1000, 2))
