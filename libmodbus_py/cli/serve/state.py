"""
The option for a file that keeps the values of the devices.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from ..output import complain

__all__ = ["add_argument", "kept"]


def add_argument(command: argparse.ArgumentParser) -> None:
    """Add the option to argparse."""
    command.add_argument(
        "--state",
        metavar="FILE",
        help="keep the values that clients write in this file, so that they survive a restart;"
        " it is written at most once a second, and at the end",
    )


@contextlib.contextmanager
def kept(path: str | None, devices: Callable[[], Any]) -> Iterator[None]:
    """
    Load the values of devices from a file, and save them to it while the block runs.

    Args:
        devices: returns the devices that are served now.

    Raises:
        ValueError: the file is used by another program, or is not a file of these devices.
    """
    if path is None:
        yield
        return
    from ...tools.simulator.values_file import ValuesFile

    try:
        file = ValuesFile(path, devices, tell=tell)
    except ValueError as error:
        raise ValueError(f"--state: {error}") from None
    with contextlib.closing(file):
        file.start()
        yield


def tell(line: str) -> None:
    """Print a line on stderr, if there is a reader."""
    with contextlib.suppress(OSError, ValueError):  # without a reader it still serves
        complain(line)
