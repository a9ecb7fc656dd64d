"""
The table ``[engine]`` of fleet files: settings of a fleet on several machines.

The table is checked wherever the file is read, on one machine too.
"""

from __future__ import annotations

from typing import Literal, get_args

from ...protocol.checks import seconds
from ...protocol.mistakes import Path
from ...tools.files.schema import Key, Keys, flag, one_of, whole

__all__ = ["ENGINE", "LONGEST_LEASE", "SHORTEST_LEASE", "OnLoss"]

OnLoss = Literal["stop", "continue"]

SHORTEST_LEASE, LONGEST_LEASE = 0.5, 60.0

# Ten years, in seconds.
LONGEST_AGE = 3.2e8


def _lease(path: Path, value: object) -> float:
    return seconds(path, value, SHORTEST_LEASE, LONGEST_LEASE)


def _age(path: Path, value: object) -> float:
    return seconds(path, value, high=LONGEST_AGE)


ENGINE = Keys(
    [
        Key("lease", _lease, "how long a worker may poll without NATS, in seconds, 0.5..60"),
        Key("on_engine_loss", one_of(*get_args(OnLoss)), "what workers do when NATS is lost"),
        Key("commands", flag, "whether points may be written through NATS"),
        Key("max_age", _age, "how long NATS keeps readings, in seconds"),
        Key("max_bytes", whole(1 << 16, 1 << 50), "how many bytes of readings NATS keeps"),
    ]
)
