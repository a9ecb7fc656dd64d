"""
The page of a gateway as people use it, in Chromium: what a line, a unit and a client did, charts of
them, the log with its filters, and a gateway that ends.
"""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Context, Device, Gateway, IllegalDataAddress, Mapping, Route, Server
from libmodbus_py.services.gateway.shown_gateway import ShownGateway
from libmodbus_py.tools.page import samples
from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.tables import TableSource
from tests.tools.page.browsers import browser, console, missing, resize
from tests.tools.page.persons import Person
from tests.tools.page.watching import Visitor, until

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.timeout(300),  # Chromium on a busy machine
]


@contextlib.contextmanager
def gateway_page(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, str, str]]:
    """Run a gateway with a page; its URL, that of the page, and that of its line."""
    monkeypatch.setattr(samples, "SAMPLED", 0.0)
    device = Device(Mapping(holding_registers=10))
    with Server(device).background("tcp://127.0.0.1:0") as behind:
        place = behind.urls[0]
        gateway = Gateway([Route(place, units="1-9")])
        shown = ShownGateway("<b>house</b>", gateway)
        with (
            gateway.tracing(shown.note),
            gateway.background("tcp://127.0.0.1:0") as running,
            table_page(TableSource(shown)) as page,
        ):
            yield running.urls[0], page.url, place


def asked(url: str, times: int = 5) -> None:
    with Context.from_url(url, unit=3, timeout=10) as plc:
        for at in range(times):
            plc.write_register(at, 7)
            plc.read_holding_registers(0, 2)
        with pytest.raises(IllegalDataAddress):
            plc.read_holding_registers(500, 1)


def test_a_person_looks_at_a_gateway(monkeypatch: pytest.MonkeyPatch) -> None:
    with gateway_page(monkeypatch) as (url, page, place), browser() as driver:
        person = Person(driver)
        driver.get(page)
        person.sees("#state", "connected")
        until(lambda: driver.title == "<b>house</b> - gateway")
        asked(url)

        # A line, and the charts of its two sparklines.
        person.sees("#rows tr[data-at='0'] th .own", place)
        person.sees("#rows tr[data-at='0'] .state", "open")
        until(lambda: person.attribute("#rows tr[data-at='0'] .spark path", "d"))
        person.click("#rows tr[data-at='0'] button")
        person.sees("#charted", f"{place}  rate")
        person.sees("#read", "requests/s")
        assert until(lambda: person.attribute("#plot .line", "d"))
        driver.execute_script(
            "document.querySelectorAll('#rows tr[data-at=\"0\"] .spark')[2].click()"
        )
        person.sees("#charted", f"{place}  queue")

        # A unit, and how long its answers took.
        person.sees("#rows tr[data-at='1'] th", "unit 3")
        person.click("#rows tr[data-at='1'] button")
        person.sees("#charted", f"{place}  unit 3  rate")
        driver.execute_script(
            "document.querySelectorAll('#rows tr[data-at=\"1\"] .spark')[1].click()"
        )
        person.sees("#charted", "unit 3  time")
        person.sees("#read", "ms")

        # Who asks what has no chart.
        person.click("#close-chart")
        person.sees("#rows", "6 write register")
        person.click("#rows tr[data-at='2'] button")
        assert driver.execute_script("return document.querySelector('#chart').hidden")
        assert [each["message"] for each in console(driver)] == []


def test_the_log_is_filtered_and_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    with gateway_page(monkeypatch) as (url, page, _), browser() as driver:
        person = Person(driver)
        driver.get(page)
        asked(url)
        person.sees("#log", "illegal data address")
        until(lambda: len(person.all("#log li")) == 11)
        person.click("#only-writes")
        until(lambda: shown(person) == 5)
        person.click("#only-writes")
        person.click("#only-errors")
        until(lambda: shown(person) == 1)
        status, _, saved = Visitor(page).ask("GET", "/log.csv")
        assert status == 200
        assert len(list(csv.DictReader(io.StringIO(saved.decode())))) == 11


def shown(person: Person) -> int:
    """Count the rows of the log that can be seen."""
    count: int = person.driver.execute_script(
        "return [...document.querySelectorAll('#log li')].filter(e => e.offsetParent).length"
    )
    return count


def test_a_gateway_that_ended_is_grey(monkeypatch: pytest.MonkeyPatch) -> None:
    with browser() as driver:
        person = Person(driver)
        with gateway_page(monkeypatch) as (_, page, place):
            driver.get(page)
            person.sees("#rows", place)
        person.sees("#state", "no connection to the server since")
        assert "lost" in person.attribute("body", "class")


@pytest.mark.parametrize("width", [360, 1200])
def test_nothing_sticks_out(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with gateway_page(monkeypatch) as (url, page, place), browser() as driver:
        person = Person(driver)
        resize(driver, width, 740)
        driver.get(page)
        asked(url)
        person.sees("#rows tr[data-at='0'] th", place)
        person.sees("#rows tr[data-at='2'] th", "127.0.0.1")
        sizes: Any = driver.execute_script(
            "const box = document.querySelector('#scroll');"
            "return [document.documentElement.scrollWidth, box.scrollWidth - box.clientWidth]"
        )
        assert sizes[0] <= width
        assert sizes[1] == 0
        assert [each["message"] for each in console(driver)] == []
