"""
Lines that lead back to where the gateway itself listens, or to no port at all.
"""

from __future__ import annotations

import os
from collections.abc import Iterable

from ...ports.endpoint import Endpoint
from ...ports.hosts import EVERYWHERE, is_loopback, is_this_machine
from ...protocol.mistakes import Path, WrongValue

__all__ = ["check_line"]


def check_line(name: Path, line: Endpoint, listening: Iterable[Endpoint]) -> None:
    """
    Check that a line leads somewhere else.

    Args:
        name: of it, for the error.
        listening: where the gateway listens.

    Raises:
        ValueError: there is no such port, or the gateway itself listens there.
    """
    if line.is_serial and not os.path.exists(line.device):
        raise WrongValue.about(name, f"there is no port {line.device}")
    for own in listening:
        if _is_same(line, own):
            raise WrongValue.about(name, f"the gateway itself listens on {own}")


def _is_same(line: Endpoint, own: Endpoint) -> bool:
    if line.place == own.place:
        return True
    if line.is_serial and own.is_serial:
        return os.path.realpath(line.device) == os.path.realpath(own.device)
    if line.place[::2] != own.place[::2]:  # of another kind, or another port
        return False
    if own.host in EVERYWHERE:
        return is_this_machine(line.host)
    is_here = line.host in EVERYWHERE or is_loopback(line.host)
    return is_here and is_loopback(own.host)
