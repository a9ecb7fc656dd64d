"""
SIGHUP again and again, before the first one was answered: the newest file counts, and no connection
is lost.
"""

from __future__ import annotations

import signal
from pathlib import Path

from libmodbus_py import Context, Device, Mapping, Server
from libmodbus_py.errors import GatewayPathUnavailable
from tests.support.commands import PAGE_TOKEN, Started, page_url
from tests.support.peers import until
from tests.tools.page.watching import Visitor

METER = "name,table,address\nlevel,holding_registers,0\n"


def test_a_gateway_ends_with_the_newest_routes(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    with Server(Device(Mapping(holding_registers={0: [555]}))).background(
        "tcp://127.0.0.1:0"
    ) as running:

        def write(units: str) -> None:
            route = f"[[route]]\nto = '{running.urls[0]}'\nunits = '{units}'\n"
            path.write_text(f"listen = ['tcp://127.0.0.1:0']\n{route}")

        write("1")
        with Started("gateway", "--config", path) as process:
            url = process.stdout.readline().removeprefix("listening on ").rstrip("\n")
            with Context.from_url(url, unit=1, timeout=5) as context:

                def has(unit: int) -> bool:
                    try:
                        return context.for_unit(unit).read_holding_registers(0, 1) == [555]
                    except GatewayPathUnavailable:
                        return False

                assert has(1)
                for unit in range(2, 40):
                    write(f"1,{unit}")
                    process.send_signal(signal.SIGHUP)
                    process.send_signal(signal.SIGHUP)
                    assert has(1)
                until(lambda: has(39))
                assert not has(38)
                assert context.statistics.connects == 1
            process.send_signal(signal.SIGHUP)
            process.terminate()
            assert process.wait() == 0


def test_a_page_shows_the_newest_devices(tmp_path: Path) -> None:
    (tmp_path / "meter.csv").write_text(METER)
    path = tmp_path / "plant.toml"
    with Server(Device(Mapping(holding_registers={0: [17]}))).background(
        "tcp://127.0.0.1:0"
    ) as running:

        def write(name: str) -> None:
            defaults = f"map = 'meter.csv'\ninterval = 0.02\nurl = '{running.urls[0]}'\n"
            path.write_text(f"[defaults]\n{defaults}[[device]]\nname = '{name}'\n")

        write("first")
        with Started("poll", path, "--page", "127.0.0.1:0", environment=PAGE_TOKEN) as process:
            url = page_url(process.stderr.readline())
            with Visitor(url).watching() as visitor:
                visitor.look_at()
                visitor.receive(lambda: visitor.rows("rows"))
                for number in range(20):
                    write(f"d{number}")
                    process.send_signal(signal.SIGHUP)
                    process.send_signal(signal.SIGHUP)
                rows = visitor.seen["rows"]
                visitor.receive(lambda: rows["0"][0][1] == "d19")
                assert sorted(rows) == ["0", "1"]
            process.send_signal(signal.SIGHUP)
            process.terminate()
            assert process.wait() == 0
