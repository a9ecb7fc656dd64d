"""
The page of a simulator in Chromium: lines and charts of values, a value that is held, and the log.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import Context, IllegalDataAddress, Server
from libmodbus_py.page import live_page
from libmodbus_py.tools.simulator.device_file import load
from tests.tools.page.browsers import browser, console, missing
from tests.tools.page.persons import Person
from tests.tools.page.test_holding import PLANT
from tests.tools.page.watching import until

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.timeout(300),  # Chromium on a busy machine
]


def test_a_person_holds_a_value_and_reads_the_log(tmp_path: Path) -> None:
    (tmp_path / "plant.toml").write_text(PLANT)
    server = Server(load(tmp_path / "plant.toml").devices)
    with (
        live_page(server) as page,
        server.background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], unit=1, timeout=5) as plc,
        browser(1400) as driver,
    ):
        person = Person(driver)
        driver.get(page.url)
        person.sees("#state", "connected")
        until(lambda: driver.title == "Unit 1 - libmodbus-py")

        # The value moves, and is drawn.
        until(lambda: "L" in (person.attribute("#rows .spark path", "d") or ""), 30)
        person.click("#rows th button", "level")
        person.sees("#charted", "level")
        person.sees("#read", "lowest")
        person.click("#close-chart")

        # It is held, set, and released.
        person.click('[data-point="0"]')
        person.click("#hold", "Hold")
        person.sees("#answer", "held")
        until(lambda: "held" in person.attribute("#rows tr[data-at]", "class"))
        person.one("#text").clear()
        person.one("#text").send_keys("5\n")
        person.sees('[data-point="0"]', "5")
        assert plc.read_holding_registers(0, 1) == [5]
        person.click("#hold", "Release")
        until(lambda: plc.read_holding_registers(0, 1) != [5])
        person.click("#close")

        # The log names what was read, and is filtered.
        plc.write_register(1, 9)
        with pytest.raises(IllegalDataAddress):
            plc.read_coils(60, 1)
        person.sees("#log .named", "fixed 9")
        person.sees("#log", "read coils 60")
        person.click("#only-errors")
        until(lambda: len(person.all("#log li")) == 1)
        person.click("#only-writes")
        until(lambda: len(person.all("#log li")) == 2)
        assert person.attribute("#save", "href") == "/log.csv?writes=1&errors=1"
        assert [each["message"] for each in console(driver)] == []
