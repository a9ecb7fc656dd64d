"""
References: the 1-based notation of manuals, such as 40123.

The only place where anything is counted from 1.
"""

from __future__ import annotations

import re
from typing import NamedTuple

__all__ = ["Reference", "parse_reference"]

TABLES = {
    "0": "coils",
    "1": "discrete_inputs",
    "3": "input_registers",
    "4": "holding_registers",
    "6": "file",
}
"""First digit of a reference -> table."""


class Reference(NamedTuple):
    """
    What a reference stands for.

    Attributes:
        table: "coils", "discrete_inputs", "input_registers",
            "holding_registers" or "file" (whose number goes separately).
        address: the 0-based address, or the record number.
    """

    table: str
    address: int


def parse_reference(text: str) -> Reference:
    """
    Read a 5- or 6-digit reference (PI-MBUS-300).

    The first digit is the table, the rest the item, from 1: "40123" is holding
    register 122. File records count from 0: "600007" is record 7.

    Args:
        text: a string, for the leading zero of coils counts.

    Raises:
        TypeError: not a string.
        ValueError: not a reference, and what one looks like.
    """
    if not isinstance(text, str):
        given = type(text).__name__
        raise TypeError(f'a reference must be a string, such as "40123", not {given}')
    if not re.fullmatch(r"[0-9]{5,6}", text) or text[0] not in TABLES:
        raise ValueError(
            f"reference {text!r} must have 5 or 6 digits and begin with 0 (coil), 1 (discrete"
            " input), 3 (input register), 4 (holding register) or 6 (file record), as in 40123"
        )
    table, item = TABLES[text[0]], int(text[1:])
    if table == "file":
        if item > 9999:
            raise ValueError(f"reference {text!r}: file records are 600000..609999")
        return Reference(table, item)
    if not 1 <= item <= 65536:
        first, last = f"{text[0]}{'1':0>{len(text) - 1}}", f"{text[0]}65536"
        raise ValueError(f"reference {text!r}: the items are {first}..{last}, counted from 1")
    return Reference(table, item - 1)
