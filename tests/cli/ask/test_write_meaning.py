"""
Times, states and named bits that are typed behind write.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from libmodbus_py import Device, Server, load_map
from tests.support.cases import each
from tests.support.commands import run

MAP = """\
name,table,address,type,states,bits,bit,time zone
state,holding,0,,0 = off; 1 = on,,,
flags,holding,1,,,0 = door; 4..7 = mode,,
clock,holding,2,unix32,,,,
local,holding,4,date48,,,,Europe/Berlin
flag,holding,7,,,,3,
"""

NOON = datetime(2026, 7, 1, 12, tzinfo=UTC)

# Name, text, value, or the error with which the command refuses it.
TYPED = [
    ("state", "on", "on"),
    ("state", "0", "off"),
    ("flags", "door=1, mode=5", {"door": True, "mode": 5}),
    ("flags", '{"door": false, "mode": 7}', {"door": False, "mode": 7}),
    ("clock", "2026-07-01T14:00:00+02:00", NOON),
    ("local", "2026-07-01T12:00:00Z", NOON),
    ("flag", "1", True),
    ("state", "up", ValueError("value must")),
    ("flags", '{"door": 1, "door": 0}', ValueError("value.door: occurs twice")),
    ("clock", "2026-07-01T12:00:00", ValueError("value must")),
]


def test_every_kind_of_value_can_be_typed(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text(MAP)
    device = Device.of_map(load_map(path))
    with Server(device).background("tcp://127.0.0.1:0") as serving:
        for check, (name, text, value) in each(TYPED):
            before = device[name]
            done = run("write", serving.urls[0], "--map", str(path), name, text)
            refused = str(value) if isinstance(value, ValueError) else None
            with check:
                assert (done.code == 0) is (refused is None), done.err
                assert device[name] == (before if refused else value)
                assert (refused or "") in done.err
