"""
Names of points as attributes of Python classes.
"""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Iterable

__all__ = ["attribute_names", "class_name"]

RESERVED = frozenset(
    {
        *("bind", "client", "datetime", "map", "read", "self", "write"),
        *("bool", "dict", "float", "int", "list", "property", "str", "super"),
    }
)
"""Names that no attribute may have, because bound maps and their classes use them."""


def attribute_names(names: Iterable[str]) -> dict[str, str]:
    """
    Return the attribute for the name of each point.

    A name that is an identifier of its own stays as it is. In others every run of characters that
    no identifier has becomes one ``_``, and those at the ends are removed; "point" stands for
    nothing, and "point_" before a digit. A name that Python or the class itself uses gets ``_``
    behind it, and one that is taken ``_2``, ``_3`` and so on, in the order of the names.
    """
    given = list(names)
    found = {name: name for name in given if _identifier(name) == name}
    taken = set(found)
    for name in given:
        if name not in found:
            found[name] = _free(_identifier(name), taken)
            taken.add(found[name])
    return {name: found[name] for name in given}


def class_name(stem: str) -> str:
    """Return the name of a class for a file without its ending: ``Sdm630V2`` for "sdm630-v2"."""
    words = [each for each in re.split("_+", _spelled(stem)) if each]
    text = "".join(word[0].upper() + word[1:] for word in words) or "Meter"
    text = unicodedata.normalize("NFKC", text)
    return text if text.isidentifier() and not keyword.iskeyword(text) else f"Map{text}"


def _identifier(name: str) -> str:
    text = _spelled(name).strip("_") or "point"
    if not text.isidentifier():
        text = f"point_{text}"
    return f"{text}_" if keyword.iskeyword(text) or text in RESERVED else text


def _spelled(name: str) -> str:
    """Return a name with one ``_`` for each run of characters that no identifier has."""
    # As Python itself spells identifiers; twice, because some letters become others and a space.
    text = unicodedata.normalize("NFKC", name)
    text = "".join(each if f"a{each}".isidentifier() else " " for each in text)
    return unicodedata.normalize("NFKC", re.sub(" +", "_", text))


def _free(text: str, taken: set[str]) -> str:
    number, found = 1, text
    while found in taken:
        number += 1
        found = f"{text}_{number}"
    return found
