"""
The page of read --watch as people use it, in Chromium.
"""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from libmodbus_py import Device, Server, load_map
from tests.support.commands import Started
from tests.tools.page.browsers import browser, console, missing
from tests.tools.page.persons import Person
from tests.tools.page.watching import until

pytestmark = [
    pytest.mark.skipif(bool(missing()), reason=missing()),
    pytest.mark.timeout(300),  # Chromium on a busy machine
]

MAP = """name,table,address,type,unit
level,holding,0,uint16,cm
"""


def test_a_person_watches_a_device(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text(MAP)
    device = Device.of_map(load_map(path), values={"level": 20})
    with Server(device).background("tcp://127.0.0.1:0") as running, browser() as driver:
        person = Person(driver)
        what = ("read", running.urls[0], "--map", path, "--watch", "0.05")
        with Started(*what, "--page", "127.0.0.1:0") as process:
            driver.get(process.stderr.readline().split()[-1])
            person.sees("#state", "connected")
            person.sees("#status", "the device answers")
            until(lambda: driver.title.endswith(" - watch"))
            person.sees("#rows tr[data-at='1'] .value", "20")
            device["level"] = 25
            person.sees("#rows tr[data-at='1'] .value", "25")
            person.click("#rows tr[data-at='1'] button")
            person.sees("#charted", "unit 1  level")
            person.sees("#read", "highest 25 cm")
            assert until(lambda: person.attribute("#plot .line", "d"))
            assert [each["message"] for each in console(driver)] == []
            process.send_signal(signal.SIGINT)
            process.wait()
        person.sees("#state", "no connection to the server since")
        assert "lost" in person.attribute("body", "class")
