"""
How --help is set: as wide as the terminal.

argparse asks shutil for that width, which imports three compressors at each start.
"""

from __future__ import annotations

import argparse
import os

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from typing import Any

__all__ = ["Help", "VerbatimHelp"]


class Help(argparse.HelpFormatter):
    """Help in which all texts are filled anew."""

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, **{"width": _columns() - 2, **options})


class VerbatimHelp(Help, argparse.RawDescriptionHelpFormatter):
    """Help whose description and epilog stay as they are."""


def _columns() -> int:
    given = os.environ.get("COLUMNS", "")
    try:
        return int(given) if given.isdecimal() else os.get_terminal_size(1).columns or 80
    except OSError:
        return 80
