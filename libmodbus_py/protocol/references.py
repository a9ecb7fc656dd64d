"""
References: how manuals number the items of tables, such as 40123.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from .mistakes import WrongValue

__all__ = ["REFERENCE_TABLES", "Reference", "parse_reference"]

REFERENCE_TABLES = {
    "0": "coils",
    "1": "discrete_inputs",
    "3": "input_registers",
    "4": "holding_registers",
    "6": "file",
}
"""First digit of a reference -> table."""


class Reference(NamedTuple):
    """
    The table and address of a reference.

    Attributes:
        table: "coils", "discrete_inputs", "input_registers",
            "holding_registers" or "file" (a reference does not contain the file number).
        address: the 0-based address, or the record number.
    """

    table: str
    address: int


def parse_reference(text: str) -> Reference:
    """
    Return the table and address of a 5- or 6-digit reference (PI-MBUS-300).

    The first digit is the table, and the rest is the number of the item, counted from 1: "40123"
    is the holding register with address 122. Only file records are counted from 0: "600007" is
    record 7.

    Args:
        text: the reference, as a string because the leading zero of coils matters.

    Raises:
        TypeError: the argument is not a string.
        ValueError: the text is not a reference; the message tells what one looks like.
    """
    if not isinstance(text, str):
        given = type(text).__name__
        raise TypeError(f'a reference must be a string, such as "40123", not {given}')
    if not re.fullmatch(r"[0-9]{5,6}", text) or text[0] not in REFERENCE_TABLES:
        raise WrongValue(
            "reference",
            f"{text!r} must have 5 or 6 digits and begin with 0 (coil), 1 (discrete"
            " input), 3 (input register), 4 (holding register) or 6 (file record), as in 40123",
        )
    table, item = REFERENCE_TABLES[text[0]], int(text[1:])
    if table == "file":
        if item > 9999:
            raise WrongValue("reference", f"{text!r}: file records are 600000..609999")
        return Reference(table, item)
    if not 1 <= item <= 65536:
        first, last = f"{text[0]}{'1':0>{len(text) - 1}}", f"{text[0]}65536"
        raise WrongValue("reference", f"{text!r}: the items are {first}..{last}, counted from 1")
    return Reference(table, item - 1)
