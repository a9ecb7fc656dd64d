"""
Checks for lines that lead back to an endpoint of the gateway itself, or to no serial port.
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
    Check that a line does not lead to the gateway itself.

    Args:
        name: the path of the line, for errors.
        line: the endpoint of the line.
        listening: the endpoints that the gateway listens on.

    Raises:
        ValueError: there is no such serial port, or the gateway itself listens on this endpoint.
    """
    if line.is_serial and not os.path.exists(line.path):
        raise WrongValue.about(name, f"there is no serial port {line.path}")
    for own in listening:
        if _is_same(line, own):
            raise WrongValue.about(name, f"the gateway itself listens on {own}")


def _is_same(line: Endpoint, own: Endpoint) -> bool:
    if line.key == own.key:
        return True
    if line.key[0] != own.key[0] or line.port != own.port:
        return False
    if line.has_path:
        return os.path.realpath(line.path) == os.path.realpath(own.path)
    if own.host in EVERYWHERE:
        return is_this_machine(line.host)
    is_here = line.host in EVERYWHERE or is_loopback(line.host)
    return is_here and is_loopback(own.host)
