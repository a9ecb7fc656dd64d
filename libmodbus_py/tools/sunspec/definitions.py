"""
The definitions of SunSpec models, from the JSON files that pysunspec2 carries.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__all__ = ["definition_of", "folder"]

# The definition of a model, as the schema of SunSpec has it.
Definition = Mapping[str, Any]


@lru_cache(256)
def definition_of(model: int) -> Definition | None:
    """
    Return the top-level group of a model's definition; None if the model is not known.

    Raises:
        ImportError: pysunspec2 is missing.
    """
    path = folder() / f"model_{model}.json"
    if not path.is_file():
        return None
    group: Definition = json.loads(path.read_text(encoding="utf-8"))["group"]
    return group


def folder() -> Path:
    """
    Return the folder of the definitions, files such as "model_103.json".

    Raises:
        ImportError: pysunspec2 is missing; the message names the extra.
    """
    # Its client, which needs pyserial, is not imported.
    found = find_spec("sunspec2")
    for place in (found and found.submodule_search_locations) or ():
        path = Path(place, "models", "json")
        if path.is_dir():
            return path
    raise ImportError(
        "SunSpec models need pysunspec2: pip install 'libmodbus-py[sunspec]'", name="sunspec2"
    )
