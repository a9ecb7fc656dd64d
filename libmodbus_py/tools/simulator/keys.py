"""
The keys of device files, and what may stand behind each.

``docs/how-to/simulator.md`` explains them all; a test holds it to these tables.
"""

from __future__ import annotations

from ...protocol.checks import integer
from ...protocol.pdu import RECORDS_PER_FILE
from ...server.faults.fault import LONGEST, Fault
from ..files import roles
from .behaviour import BEHAVIOURS
from .checks import (
    Check,
    a_list,
    anything,
    bytes_or_text,
    flag,
    made_by,
    one_of,
    table,
    tables,
    text,
    whole,
)

# fmt: off
__all__ = [
    "ACCESS", "CONTENT", "DEFAULTS", "FAULT", "FIFO", "FILE", "MOVES", "NAMES", "RANGES", "SCALE",
    "SERVER_ID", "TYPE", "UNIT",
]
# fmt: on

ACCESS = {
    "read_write": (True, True),
    "read": (True, False),
    "write": (False, True),
}
"""How a range can be accessed -> whether clients can read, and write."""


def unit_id(name: str, value: object) -> int:
    number = integer(name, value, 0, 255)
    if 247 < number < 255:
        raise ValueError(f"{name} must be in 0..247, or 255, not {number}")
    return number


FILE: dict[str, Check] = {
    "unit": tables,
    "fault": tables,
    "roles": roles.rules,
    "defaults": table,
}

UNIT: dict[str, Check] = {
    "id": unit_id,
    "name": text(100),
    "description": text(250),
    "exception_status": whole(0, 255),
    "server_id": table,
    "identification": table,
    "defaults": table,
    "map": anything,
    "values": table,
    "moves": table,
    "coils": tables,
    "discrete_inputs": tables,
    "holding_registers": tables,
    "input_registers": tables,
    "file": tables,
    "fifo": tables,
    "fault": tables,
    "roles": roles.rules,
}

SERVER_ID: dict[str, Check] = {
    "identifier": bytes_or_text(1, 125),
    "running": flag,
    "additional": bytes_or_text(0, 125),
}

FIFO: dict[str, Check] = {"address": whole(0, 0xFFFF), "values": a_list}

CONTENT: dict[str, Check] = {"value": anything, "values": a_list}

TYPE: dict[str, Check] = {
    "type": anything,
    "order": anything,
    "encoding": anything,
    "padding": anything,
}

PLACE: dict[str, Check] = {"address": whole(0, 0xFFFF), "count": whole(1, 0x10000)}

NAMES: dict[str, Check] = {"name": anything, "description": anything}

SCALE: dict[str, Check] = {"unit": anything, "scale": anything, "offset": anything}

MOVES: dict[str, Check] = {name: made_by(make) for name, make in BEHAVIOURS.items()}

CAN: dict[str, Check] = {"access": one_of(*ACCESS)}

DEFAULTS: dict[str, Check] = TYPE | CAN
"""What a range has unless it says something else."""

FAULT: Check = made_by(Fault, data=bytes_or_text(1, LONGEST))

RANGES: dict[str, dict[str, Check]] = {
    "coils": PLACE | CONTENT | CAN | MOVES | NAMES,
    "discrete_inputs": PLACE | CONTENT | MOVES | NAMES,
    "holding_registers": PLACE | CONTENT | TYPE | CAN | MOVES | NAMES | SCALE,
    "input_registers": PLACE | CONTENT | TYPE | MOVES | NAMES | SCALE,
    "file": {
        "number": whole(1, 0xFFFF),
        "record": whole(0, RECORDS_PER_FILE - 1),
        "count": whole(1, RECORDS_PER_FILE),
    }
    | CONTENT
    | TYPE
    | CAN,
}
"""Table -> the keys of its ranges."""
