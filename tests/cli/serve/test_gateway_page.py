"""
gateway --page: its lines, units and clients in a browser.
"""

from __future__ import annotations

import signal

from libmodbus_py import Context, Device, Mapping, Server
from tests.support.commands import PAGE_TOKEN, Started, page_url
from tests.tools.page.watching import Visitor


def test_the_gateway_is_shown() -> None:
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as behind:
        place = behind.urls[0]
        command = ("gateway", "tcp://127.0.0.1:0", "--to", place, "--page", "127.0.0.1:0")
        with Started(*command, environment=PAGE_TOKEN) as process:
            page, listening = sorted((process.stdout.readline() for _ in range(2)), reverse=True)
            with Visitor(page_url(page)).watching() as visitor:
                assert visitor.seen["head"]["kind"] == "gateway"
                assert visitor.seen["head"]["title"] == "tcp://127.0.0.1:0"
                with Context.from_url(listening.split()[-1], unit=5, timeout=10) as plc:
                    plc.read_holding_registers(0, 2)
                visitor.receive(lambda: visitor.seen["log"])
                visitor.look_at(find="127.0.0.1 function")
                visitor.receive(lambda: visitor.rows("rows"))
                assert visitor.seen["rows"]["0"][:3] == [
                    ["127.0.0.1", "unit 5, 3 read holding registers"],
                    ["client", "", 0],
                    1,
                ]
            process.send_signal(signal.SIGTERM)
            process.wait()
