"""
Append a worked example to vectors.json, made of its PDU: ./run python -m tests.support.vector_row

The check bytes are computed by `talk`, which shares no code with the package.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from tests.support.driver import ascii_frame, rtu

FILE = Path(__file__).with_name("vectors.json")


def frame_row(
    id: str, place: str, unit: int, pdu: bytes, fields: dict[str, Any], answers: str | None = None
) -> dict[str, Any]:
    """
    Return the row of a message in each form. `id`: of the row; `place`: where in its document the
    example stands; `unit`: the unit of the frames; `pdu`: the message; `fields`: what the document
    says of it, for `tests/protocol/pdu/examples.py`; `answers`: the id of the request, for a
    response.
    """
    body = bytes([unit]) + pdu
    kind = "exception" if pdu[0] & 0x80 else "response" if answers else "request"
    forms = {
        "pdu": pdu.hex().upper(),
        "rtu": rtu(body.hex()).hex().upper(),
        "ascii": ascii_frame(body.hex()).decode(),
        "tcp": f"00010000{len(body):04X}{body.hex().upper()}",
    }
    about = {"id": id, "place": place, "kind": kind, "function": pdu[0] & 0x7F, "unit": unit}
    pair = {"pairs_with": answers} if answers else {}
    computed = {"tcp_transaction": 1, "computed": ["rtu", "ascii", "tcp"], "unit_assumed": True}
    return {**about, **forms, **computed, **pair, "fields": fields}


def appended(text: str, row: dict[str, Any]) -> str:
    """Return the text of a file of rows with one more; raise a ValueError if its id is there."""
    if any(load["id"] == row["id"] for load in json.loads(text)):
        raise ValueError(f"there is a row {row['id']!r}")
    return f"{text.rstrip().removesuffix(']').rstrip()},\n {json.dumps(row)}\n]\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="./run python -m tests.support.vector_row")
    parser.add_argument("id", help="such as own-fc05-req")
    parser.add_argument("place", help="where in its document the example stands")
    parser.add_argument("pdu", type=bytes.fromhex, help="hexadecimal digits, such as 0500ACFF00")
    parser.add_argument("--unit", type=int, default=1, help="the unit of the frames (1)")
    parser.add_argument("--answers", metavar="ID", help="the row of the request, for a response")
    parser.add_argument(
        "--fields", type=json.loads, default={}, help='such as \'{"address": 172, "value": "ON"}\''
    )
    options = parser.parse_args()
    row = frame_row(
        options.id, options.place, options.unit, options.pdu, options.fields, options.answers
    )
    try:
        FILE.write_text(appended(FILE.read_text(), row))
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
