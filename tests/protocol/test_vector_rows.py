"""
Rows of worked examples: the frames in the file are those of their PDUs.
"""

import json

import pytest

from tests.support.vector_row import FILE, appended, frame_row
from tests.support.vectors import FRAMES, FrameVector, rows


@pytest.mark.parametrize("vector", rows(FRAMES))
def test_each_form_is_that_of_the_pdu(vector: FrameVector) -> None:
    request = vector.request or ("none" if vector.kind == "response" else None)
    row = frame_row(vector.id, vector.place, vector.unit, vector.pdu, {}, request)
    assert bytes.fromhex(row["rtu"]) == vector.rtu
    assert row["ascii"].encode() == vector.ascii
    assert bytes.fromhex(row["tcp"])[2:] == vector.tcp[2:]  # behind the transaction
    assert (row["kind"], row["function"]) == (vector.kind, vector.function)


def test_a_row_is_appended_once() -> None:
    text = FILE.read_text()
    row = frame_row("own-new", "6.5", 1, bytes.fromhex("0500ACFF00"), {"value": "ON"})
    more = appended(text, row)
    assert json.loads(more) == [*json.loads(text), row]
    assert more.startswith(text.rstrip("\n]"))
    with pytest.raises(ValueError, match="there is a row 'own-new'"):
        appended(more, row)
