"""
The page of a gateway as people use it, in Chromium: what a line, a unit and a client did, charts of
them, and the log.
"""

import pytest

from libmodbus_py import Client, Device, Gateway, IllegalDataAddress, Mapping, Route, Server
from libmodbus_py.services.gateway.shown_gateway import ShownGateway
from libmodbus_py.tools.page import samples
from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.table_source import TableSource
from tests.support.peers import until
from tests.tools.page.browsers import IN_BROWSER, person_at

pytestmark = IN_BROWSER


def test_a_person_looks_at_a_gateway(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "SAMPLED", 0.0)
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as behind:
        place = behind.urls[0]
        gateway = Gateway([Route(place, units="1-9")])
        view = ShownGateway("<b>house</b>", gateway)
        with (
            gateway.tracing(view.note),
            gateway.background("tcp://127.0.0.1:0") as running,
            table_page(TableSource(view)) as page,
            Client(running.urls[0], unit=3, timeout=10) as plc,
            person_at(page.url) as person,
        ):
            person.sees("#status", "no line is down")
            until(lambda: person.driver.title == "<b>house</b> - gateway")
            for at in range(5):
                plc.write_register(at, 7)
                plc.read_holding_registers(0, 2)
            with pytest.raises(IllegalDataAddress):
                plc.read_holding_registers(500, 1)

            # A line and a unit, with charts of their sparklines; a client has none.
            person.sees("#rows tr[data-at='0'] th .own", place)
            person.sees("#rows tr[data-at='0'] .state", "open")
            person.sees("#rows tr[data-at='1'] th", "unit 3")
            person.sees("#rows", "6 write register")
            for row, name in ((0, place), (1, f"{place}  unit 3")):
                until(lambda: person.attribute("#rows tr[data-at='0'] .spark path", "d"))
                person.click(f"#rows tr[data-at='{row}'] button")
                person.sees("#charted", f"{name}  rate")
                person.sees("#read", "requests/s")
                assert until(lambda: person.attribute("#plot .line", "d"))
            person.run("document.querySelectorAll('#rows tr[data-at=\"1\"] .spark')[1].click()")
            person.sees("#charted", "unit 3  time")
            person.click("#close-chart")
            person.click("#rows tr[data-at='2'] button")
            assert person.run("return document.querySelector('#chart').hidden")
            person.sees("#log", "illegal data address")
            until(lambda: len(person.all("#log li")) == 11)

            # On a telephone, nothing sticks out.
            person.resize(360, 740)
            sizes = person.run(
                "const box = document.querySelector('#scroll');"
                "return [document.documentElement.scrollWidth, box.scrollWidth - box.clientWidth]"
            )
            assert sizes == [360, 0]
            assert person.complaints() == []
