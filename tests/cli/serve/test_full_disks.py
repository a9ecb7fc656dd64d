"""
A disk that takes no more while poll writes a journal and shows a page: both go on, and the journal
is written again once there is room.
"""

from __future__ import annotations

import resource
import signal
import sqlite3
from contextlib import closing
from pathlib import Path

from libmodbus_py import Device, Mapping, Server
from tests.support.commands import PAGE_TOKEN, Started, page_url
from tests.tools.page.watching import Visitor

METER = "name,table,address\nlevel,holding_registers,0\n"


def test_a_journal_without_room_ends_nothing(tmp_path: Path) -> None:
    (tmp_path / "meter.csv").write_text(METER)
    path = tmp_path / "plant.toml"
    mapping = Mapping(holding_registers=1)
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        path.write_text(
            "journal = 'fleet.db'\n[defaults]\nmap = 'meter.csv'\ninterval = 0.02\n"
            f"[[device]]\nname = 'one'\nurl = '{running.urls[0]}'\n"
        )
        command = ("poll", path, "--page", "127.0.0.1:0")
        with Started(*command, folder=tmp_path, environment=PAGE_TOKEN) as process:
            with Visitor(page_url(process.stderr.readline())).watching() as visitor:
                visitor.look_at()
                visitor.receive(lambda: len(visitor.rows("rows")) == 3)
                rows = visitor.seen["rows"]
                visitor.receive(lambda: rows["2"][2][0] == "0")
                # As on a full disk, no file grows from here on.
                limits = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
                resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (0, limits[1]))
                told = process.stderr.readline()
                assert "fleet.db: the disk" in told
                mapping.holding_registers[0] = 7
                visitor.receive(lambda: rows["2"][2][0] == "7")
                assert visitor.history(["one", "level"], 60)["values"][-1] == 7
                resource.prlimit(process.pid, resource.RLIMIT_FSIZE, limits)
                while "accepts readings again" not in process.stderr.readline():
                    pass
            process.send_signal(signal.SIGTERM)
            assert process.wait() == 0
    with closing(sqlite3.connect(tmp_path / "fleet.db")) as database:
        values = [value for (value,) in database.execute("SELECT value FROM reading ORDER BY id")]
    assert values == sorted(values)
    assert {0, 7} == set(values)
