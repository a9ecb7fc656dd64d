"""
The page of a server as people use it: in Chromium, with a mouse, with a keyboard alone, in a narrow
window, while a client talks to the server, and with values that move.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import (
    Context,
    Device,
    Fault,
    IllegalDataAddress,
    Mapping,
    Server,
    ServerDeviceBusy,
)
from libmodbus_py.page import live_page
from libmodbus_py.tools.simulator.device_file import load
from tests.tools.page.browsers import browser, console, missing, resize
from tests.tools.page.persons import Person
from tests.tools.page.test_changes import PLANT
from tests.tools.page.watching import made_server, until

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.timeout(300),  # Chromium on a busy machine
]


def test_a_person_uses_the_page() -> None:
    from selenium.webdriver.common.keys import Keys

    server = made_server(faults={1: [Fault("exception", code=6, function=4)]})
    with (
        live_page(server) as page,
        server.background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], unit=1, timeout=5) as plc,
        browser() as driver,
    ):
        person = Person(driver)
        driver.get(page.url)
        person.sees("#state", "connected")
        assert "token" not in driver.current_url
        assert driver.execute_script("return document.cookie") == ""

        # Names are text, whatever stands in them.
        person.sees("#units", "tank <script>alert(1)</script>")
        person.sees('[data-point="0"]', "21.5")

        # A client writes, and the page shows what, and who it was.
        plc.write_values("holding_registers", 0, [-7.25], "float32", order="CDAB")
        person.sees('[data-point="0"]', "-7.25")
        person.sees("#rows", "127.0.0.1")
        person.sees("#log", "write holding registers 0..1: ")

        # Somebody types a value, and the client reads it.
        person.click('[data-point="1"]')
        person.one("#text").clear()
        person.one("#text").send_keys("12.5")
        person.click("#set")
        until(lambda: plc.read_holding_registers(2, 1) == [125])
        person.sees("#answer", "set")

        # What cannot be is told beside the field.
        person.one("#text").clear()
        person.one("#text").send_keys("hot")
        person.click("#set")
        person.sees("#answer", "value must be a number, not 'hot'")
        assert person.one("#text").get_attribute("aria-invalid") == "true"
        assert plc.read_holding_registers(2, 1) == [125]
        person.click("#close")

        # A fault is switched, and the client sees it.
        with pytest.raises(ServerDeviceBusy):
            plc.read_input_registers(0, 1)
        person.click("#faults button")
        until(lambda: person.attribute("#faults button", "aria-checked") == "false")
        until(lambda: _reads(plc))

        # With the keyboard alone: to the tab of the coils, along them, and one is on.
        driver.execute_script("document.querySelector('#tables button').focus()")
        person.types(Keys.TAB, Keys.ENTER)
        until(lambda: driver.execute_script("return location.hash") == "#1/coils")
        person.sees('[data-cell="3"]', "0")
        driver.execute_script("document.querySelector('#scroll').focus()")
        person.types(Keys.TAB, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.SPACE)
        until(lambda: plc.read_coils(3, 1) == [True])
        person.sees('[data-cell="3"]', "1")
        width = driver.execute_script(
            "return getComputedStyle(document.activeElement).outlineWidth"
        )
        assert width == "2px"

        # Registers with a type, from the keyboard, and away with Escape.
        person.click("#tables button", "Holding")
        until(lambda: person.all('[data-cell="100"]'))
        driver.execute_script("document.querySelector('[data-cell=\"100\"]').focus()")
        person.types(Keys.ENTER)
        until(lambda: driver.switch_to.active_element.get_attribute("id") == "text")
        driver.execute_script("document.querySelector('#type').value = 'float32'")
        person.types("1.5", Keys.ENTER)
        until(lambda: plc.read_values("holding_registers", 100, "float32") == [1.5])
        person.types(Keys.ESCAPE)
        until(lambda: driver.switch_to.active_element.get_attribute("data-cell") == "100")

        # The log is paused, cleared, and goes on.
        person.click("#pause")
        person.click("#clear")
        until(lambda: not person.text("#log"))
        plc.read_holding_registers(7, 1)
        person.click("#pause")
        person.sees("#log", "read holding registers 7")

        # A narrow window: nothing sticks out, and all is there.
        resize(driver, 360, 740)
        person.click("#tables button", "Points")
        person.sees('[data-point="0"]', "-7.25")
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 360
        person.click("#tables button", "Holding")
        person.sees('[data-cell="0"]', "0")
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 360

        # Nothing was blocked, and nothing was missing but the value that was refused.
        told = [each["message"] for each in console(driver)]
        assert [each for each in told if "/value - " not in each] == []


def _reads(plc: Context) -> bool:
    try:
        plc.read_input_registers(0, 1)
    except ServerDeviceBusy:
        return False
    return True


def test_large_tables_and_a_server_that_goes() -> None:
    mapping = Mapping(coils=65536, holding_registers=65536)
    mapping.holding_registers[65535] = 4711
    with browser() as driver:
        person = Person(driver)
        with live_page(Server(Device(mapping))) as page:
            driver.get(f"{page.url}#every/holding_registers")
            person.sees("#state", "connected")
            person.sees('[data-cell="0"]', "0")
            assert len(person.all("[data-cell]")) < 1000  # only what is seen is there
            person.one("#address").send_keys("65535\n")
            person.sees('[data-cell="65535"]', "4711")
            assert driver.switch_to.active_element.get_attribute("data-cell") == "65535"
        person.sees("#state", "no connection")


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

        # Values are a table, also to those who cannot see them.
        for tab, head in (("olding", "+1"), ("oints", "Last written")):
            person.click("#tables button", tab)
            person.sees("#heads", head)
            assert person.attribute("#heads th", "scope") == "col"
            assert person.attribute("#rows [data-at] th", "scope") == "row"
            assert len(person.all("#rows [data-at='0'] > *")) == len(person.all("#heads th"))

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
