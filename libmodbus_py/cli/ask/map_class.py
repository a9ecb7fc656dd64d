"""
A Python class for a register map.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path, PurePath

from ...tools.files.maps.class_text import MARK, class_text
from ...tools.files.maps.map_file import load_map
from ...tools.simulator.example_files import map_file
from ..output import counted

__all__ = ["write_class"]


def write_class(options: argparse.Namespace) -> int:
    """Write a class for a register map to a file, or print it."""
    map = load_map(map_file(options.file))
    text = class_text(map, PurePath(options.file).stem)
    if options.output is None:
        print(text, end="", flush=True)
        return 0
    _check_output(options.output)
    Path(options.output).write_text(text, encoding="utf-8")
    print(f"{options.output}: {counted(len(map), 'point')}", file=sys.stderr)
    return 0


def _check_output(output: str) -> None:
    """Refuse to overwrite a file that this command has not written."""
    path = Path(output)
    if path.suffix != ".py":
        raise ValueError(f"{output}: it must end with .py")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"{output}: the folder does not exist")
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            start = file.read(2000)
    except FileNotFoundError:
        return
    if MARK not in start:
        raise ValueError(f"{output} exists, and would be overwritten")
