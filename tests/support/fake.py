"""
See `peers`, which has all of it.
"""

from __future__ import annotations

from tests.support.peers import (
    Answer,
    FakeServer,
    FakeUnit,
    dead,
    echo,
    mbap,
    refusing,
    until,
    url_of,
)

# fmt: off
__all__ = [
    "Answer", "FakeServer", "FakeUnit", "dead", "echo", "mbap", "refusing", "until", "url_of",
]
# fmt: on
