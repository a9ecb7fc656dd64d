"""
Pages as people use them: in Chromium, with a mouse, with a keyboard alone, in a window as narrow as
that of a telephone, with values that move, with names that are attacks, and a server that goes.
"""

import threading
import time
from collections.abc import Mapping as MappingABC
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, Fault, IllegalDataAddress, Mapping, Server
from libmodbus_py.page import live_page
from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.table_source import TableSource
from libmodbus_py.tools.simulator.device_file import load
from tests.support.peers import until
from tests.tools.page.browsers import IN_BROWSER, person_at
from tests.tools.page.tables import HOSTILE, Plant
from tests.tools.page.test_changes import PLANT
from tests.tools.page.watching import Visitor, is_served, make_server

pytestmark = IN_BROWSER


def test_a_browser_shows_and_changes_values() -> None:
    from selenium.webdriver.common.keys import Keys

    server = make_server(faults={1: [Fault("exception", code=6, function=4)]})
    with (
        live_page(server) as page,
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=5) as plc,
        person_at(page.url) as person,
    ):
        person.sees("#state", "connected")
        assert "token" not in person.driver.current_url
        assert person.run("return document.cookie") == ""

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
        person.enters("#text", "12.5")
        person.click("#set")
        until(lambda: plc.read_holding_registers(2, 1) == [125])
        person.sees("#answer", "set")

        # A value that is refused is reported beside the field.
        person.enters("#text", "hot")
        person.click("#set")
        person.sees("#answer", "value must be a number, not 'hot'")
        assert person.one("#text").get_attribute("aria-invalid") == "true"
        assert plc.read_holding_registers(2, 1) == [125]
        person.click("#close")

        # A fault is switched, and the client sees it.
        reads = partial(is_served, lambda: plc.read_input_registers(0, 1))
        assert not reads()
        person.click("#faults button")
        until(lambda: person.attribute("#faults button", "aria-checked") == "false")
        until(reads)

        # With the keyboard alone: to the tab of the coils, along them, and one is on.
        person.focus("#tables button")
        person.types(Keys.TAB, Keys.ENTER)
        until(lambda: person.run("return location.hash") == "#1/coils")
        person.sees('[data-cell="3"]', "0")
        person.focus("#scroll")
        person.types(Keys.TAB, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.SPACE)
        until(lambda: plc.read_coils(3, 1) == [True])
        person.sees('[data-cell="3"]', "1")
        width = person.run("return getComputedStyle(document.activeElement).outlineWidth")
        assert width == "2px"

        # Registers with a type, from the keyboard, and away with Escape.
        person.click("#tables button", "Holding")
        until(lambda: person.all('[data-cell="100"]'))
        person.focus('[data-cell="100"]')
        person.types(Keys.ENTER)
        until(lambda: person.focused("id") == "text")
        person.run("document.querySelector('#type').value = 'float32'")
        person.types("1.5", Keys.ENTER)
        until(lambda: plc.read_values("holding_registers", 100, "float32") == [1.5])
        person.types(Keys.ESCAPE)
        until(lambda: person.focused("data-cell") == "100")

        # The log is paused, cleared, and goes on.
        person.click("#pause")
        person.click("#clear")
        until(lambda: not person.text("#log"))
        plc.read_holding_registers(7, 1)
        person.click("#pause")
        person.sees("#log", "read holding registers 7")

        # A narrow window: nothing sticks out, and all is there.
        person.resize(360, 740)
        person.click("#tables button", "Points")
        person.sees('[data-point="0"]', "-7.25")
        assert person.run("return document.documentElement.scrollWidth") <= 360
        person.click("#tables button", "Holding")
        person.sees('[data-cell="0"]', "0")
        assert person.run("return document.documentElement.scrollWidth") <= 360

        # Nothing was blocked, and nothing was missing but the value that was refused.
        complaints = person.complaints()
        assert [complaint for complaint in complaints if "/value - " not in complaint] == []


def test_a_browser_shows_large_tables_and_a_stopped_server() -> None:
    mapping = Mapping(coils=65536, holding_registers=65536)
    mapping.holding_registers[65535] = 4711
    with person_at() as person:
        with live_page(Server(Device(mapping))) as page:
            person.driver.get(f"{page.url}#every/holding_registers")
            person.sees("#state", "connected")
            person.sees('[data-cell="0"]', "0")
            assert len(person.all("[data-cell]")) < 1000  # only the rows in view exist
            person.one("#address").send_keys("65535\n")
            person.sees('[data-cell="65535"]', "4711")
            assert person.focused("data-cell") == "65535"
        person.sees("#state", "no connection")


def test_a_person_holds_a_value_and_reads_the_log(tmp_path: Path) -> None:
    (tmp_path / "plant.toml").write_text(PLANT)
    server = Server(load(tmp_path / "plant.toml").devices)
    with (
        live_page(server) as page,
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1, timeout=5) as plc,
        person_at(page.url, 1400) as person,
    ):
        person.sees("#state", "connected")
        until(lambda: person.driver.title == "Unit 1 - libmodbus-py")

        # Values are a table, also to those who cannot see them.
        for tab, head in (("olding", "+1"), ("oints", "Last written")):
            person.click("#tables button", tab)
            person.sees("#heads", head)
            assert person.attribute("#heads th", "scope") == "col"
            assert person.attribute("#rows [data-at] th", "scope") == "row"
            assert len(person.all("#rows [data-at='0'] > *")) == len(person.all("#heads th"))

        # The value moves, and is drawn.
        until(lambda: "L" in (person.attribute("#rows .spark path", "d") or ""))
        person.click("#rows th button", "level")
        person.sees("#charted", "level")
        person.sees("#read", "lowest")
        person.click("#close-chart")

        # It is held, set, and released.
        person.click('[data-point="0"]')
        person.click("#hold", "Hold")
        person.sees("#answer", "held")
        until(lambda: "held" in person.attribute("#rows tr[data-at]", "class"))
        person.enters("#text", "5\n")
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
        assert person.attribute("#save", "href") == "log.csv?writes=1&errors=1"
        assert person.complaints() == []


TOKEN = "Bookmarked-by_the-plant-2026"


def plant_of(points: int, every: float | None = 5.0, **options: Any) -> Plant:
    plant = Plant(**options)
    plant.describe(*(("meter", f"p{at}") for at in range(points)), every=every)
    return plant


def moved(plant: Plant) -> None:
    """Put values of the last five minutes; for half a minute nothing came, not even a failure."""
    now = time.time()
    for at in (*range(30), *range(36, 60)):
        plant.put("meter", "p2", 100 + at % 10, now - 300 + at * 5)


def test_a_person_looks_at_a_fleet() -> None:
    from selenium.webdriver.common.keys import Keys

    plant = plant_of(3000)
    moved(plant)
    with table_page(TableSource(plant)) as page, person_at(page.url) as person:
        person.sees("#state", "connected")
        person.sees("#status", "0 of 1 devices down")
        person.sees("#title", "plant.toml")
        until(lambda: person.driver.title == "plant.toml - fleet")
        assert "token" not in person.driver.current_url

        # A real table, of which only the visible rows exist.
        person.sees("#rows tr[data-at='3'] .value", "109V")
        assert person.attribute("#grid", "aria-rowcount") == "3002"
        assert person.attribute("#heads th", "scope") == "col"
        assert person.attribute("#rows tr[data-at] th", "scope") == "row"
        assert person.text("#grid caption") == "Values"
        assert len(person.all("#rows tr")) < 100
        assert person.attribute("#rows tr[data-at='3'] svg path", "d").count("M") == 2  # the gap

        # A value changes, and its device is down.
        plant.put("meter", "p0", 21.5)
        person.sees("#rows tr[data-at='1'] .value", "21.5")
        plant.put("meter", "p0", None, quality="down", reason="ModbusTimeoutError")
        plant.meters["meter"].reason = "no answer within 1 s"
        plant.counts["down"] = 1
        person.sees("#status.problem", "1 of 1 devices down")
        until(lambda: person.driver.title == "1 down - plant.toml - fleet")
        person.click("#problems")
        until(lambda: person.attribute("#grid", "aria-rowcount") == "2")
        person.sees("#rows .state", "no answer within 1 s")
        person.click("#problems")

        # The last rows, and those that were searched for.
        person.sees("#rows tr[data-at='3'] .value", "109")
        person.run("document.querySelector('#scroll').scrollTop = 1e9")
        person.sees("#rows", "p2999")
        person.one("#find").send_keys("p1234")
        until(lambda: person.attribute("#grid", "aria-rowcount") == "2")
        person.sees("#rows", "p1234")
        person.one("#find").send_keys(Keys.CONTROL, "a", Keys.DELETE)
        person.sees("#rows tr[data-at='3'] .value", "109")

        # With the keyboard: along the rows, and to the chart.
        person.focus('#rows [data-at="1"] button')
        person.types(Keys.ARROW_DOWN, Keys.ARROW_DOWN, Keys.ENTER)
        person.sees("#charted", "meter  p2")
        person.sees("#read", "lowest 100 V, highest 109 V")
        path = until(lambda: person.attribute("#plot .line", "d"))
        assert path.count("M") == 2  # the gap
        person.focus("#plot")
        person.types(Keys.ARROW_LEFT)
        person.sees("#read", "109 V")
        person.types(Keys.ESCAPE)
        until(lambda: person.run("return document.querySelector('#chart').hidden"))
        assert person.complaints() == []


class HeldSource(TableSource):
    """Its first search is answered when it is let go: the next requests could overtake it."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.searched: list[str] = []
        self.go = threading.Event()

    def view(self, query: MappingABC[str, Any]) -> Any:
        if words := query["find"]:
            self.searched.append(words)
            if len(self.searched) == 1:
                assert self.go.wait(60)
        return super().view(query)


def test_the_result_of_the_latest_search_is_shown() -> None:
    """The server would go on showing the view of the one that came last."""
    source = HeldSource(plant_of(3000))
    with table_page(source) as page, person_at(page.url) as person:
        person.sees("#rows", "p1")
        person.one("#find").send_keys("p1234")
        until(lambda: source.searched)
        typed = person.run("return document.querySelector('#find').value")
        assert typed == "p1234"
        assert source.searched == ["p"]
        source.go.set()
        until(lambda: person.attribute("#grid", "aria-rowcount") == "2")
        person.sees("#rows", "p1234")
        assert source.searched == ["p", "p1234"]


def test_a_browser_shows_hours_of_the_journal_and_values_reported_on_change() -> None:
    now = time.time()
    hours = [(now - 20_000 + at * 100, float(at)) for at in range(150)]
    plant = plant_of(3, every=None, older=lambda *names: hours)
    moved(plant)
    with table_page(TableSource(plant)) as page, person_at(page.url) as person:
        person.click("#rows tr[data-at='3'] button")
        person.sees("#read", "lowest 100 V, highest 109 V")
        path = until(lambda: person.attribute("#plot .line", "d"))
        assert "L" not in path  # a line would show values that there were not
        assert path.count("H") > path.count("V") > 40
        right = float(person.run("return document.querySelector('#plot').clientWidth"))
        assert float(path.rpartition("H")[2]) > right - 30  # the last value holds until now
        person.click("#spans button", "6 h")
        person.sees("#read", "lowest 0 V, highest 149 V")


# The reasons that do not fit their rows, or the window.
CUT = """
const isCut = (each) => each.scrollHeight > each.parentElement.clientHeight + 1
  || each.scrollWidth > each.clientWidth || each.getBoundingClientRect().right > innerWidth
  || !each.offsetParent;
const reasons = [...document.querySelectorAll("#rows .trouble .state")];
return reasons.filter(isCut).map((each) => each.textContent);
"""

# How much the page and its table are wider than the window.
WIDER = """
const box = document.querySelector("#scroll");
return [document.documentElement.scrollWidth > innerWidth, box.scrollWidth > box.clientWidth];
"""


@pytest.mark.parametrize("width", [360, 1280])
def test_long_and_hostile_names_are_shown_as_plain_text(width: int) -> None:
    plant = Plant(title="<script>document.title='hit'</script>")
    names = [*HOSTILE, "n" * 1_000_000]
    plant.describe(*((name, name) for name in names), ("meter", "p1"))
    for name in names:
        plant.put(name, name, name, quality="bad", reason=name)
    plant.put("meter", "p1", None, reason="GatewayTargetFailedToRespond")
    meter = plant.meters["meter"]
    meter.reason = "cannot connect to tcp://192.0.2.10: Connection refused"
    with table_page(TableSource(plant)) as page, person_at(page.url, width, 740) as person:
        person.sees("#rows", HOSTILE[0])
        person.sees("#rows", "__proto__")
        person.click("#rows tr[data-at='1'] button")
        person.sees("#plot", "no numbers in this period")
        assert person.all("#values script, #values img") == []
        assert person.driver.title == "<script>document.title='hit'</script> - fleet"
        assert person.run("return ({}).polluted") is None
        assert person.run(WIDER) == [False, False]

        person.click("#close-chart")
        person.one("#find").send_keys("meter")
        until(lambda: person.attribute("#grid", "aria-rowcount") == "3")
        person.sees("#rows tr.trouble .state", "192.0.2.10: Connection refused")
        assert person.run(CUT) == []
        person.click("#problems")  # on this page, rows have room for more words
        meter.reason = f"cannot connect to {'a-long-name.' * 8}: Connection refused"
        person.sees("#rows tr.trouble .state", "a-long-name.: Connection refused")
        assert person.run(CUT) == []
        meter.reason = ""
        person.sees("#rows tr.trouble .state", "gateway target failed to respond")
        assert person.run(CUT) == []
        assert person.complaints() == []


def test_a_page_that_lost_its_server_is_grey_and_reconnects() -> None:
    with person_at() as person:
        with table_page(TableSource(plant_of(5)), token=TOKEN) as page:
            port = Visitor(page.url).address[1]
            person.driver.get(page.url)
            person.sees("#rows", "p4")
        person.sees("#state", "no connection to the server since")
        assert "lost" in person.attribute("body", "class")
        with table_page(TableSource(plant_of(2, title="another")), "127.0.0.1", port, TOKEN):
            person.sees("#state", "connected")
            until(lambda: person.driver.title == "another - fleet")
            until(lambda: "p4" not in person.text("#rows"))
            assert "lost" not in person.attribute("body", "class")
        person.sees("#state", "no connection")
        # Another program at this address, with the same bookmark, has another page.
        with live_page(make_server(), "127.0.0.1", port, TOKEN):
            person.sees("#units", "tank")
        person.sees("#state", "no connection")
        with live_page(make_server(), "127.0.0.1", port):
            person.sees("#state", "new token")
