"""
A register map, made of the SunSpec models of a device.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import closing

from ...tools.sunspec.discovery import discover
from ..connecting import connected, endpoint_of
from ..failing import CommandError
from ..output import PROGRAM, complain, counted
from .map_from_device import form_of, write

__all__ = ["from_sunspec"]


def from_sunspec(options: argparse.Namespace) -> int:
    """Find the SunSpec models of a device, and write a map of their points."""
    text_of = form_of(options.output)
    with closing(connected(options)) as context:
        try:
            device = discover(context)
        except ImportError as error:
            raise CommandError(str(error)) from None
    for note in device.notes:
        complain(note)
    heading = f"# SunSpec models of {endpoint_of(options)}, found by {PROGRAM} map from-sunspec"
    models = f"# {', '.join(f'{model.id} {model.name}' for model in device)}"
    write(options.output, "\n".join([heading, models, "", text_of(device.map.values())]))
    if options.output is not None:
        print(f"{options.output}: {counted(len(device.map), 'point')}", file=sys.stderr)
    return 0
