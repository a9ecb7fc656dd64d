"""read --watch --page: the values in a browser too, while they are printed as without it."""

import signal
from typing import Any

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.ask.formatters import ReadResult, ValueText
from libmodbus_py.cli.ask.items import Item
from libmodbus_py.cli.ask.shown_watch import ShownWatch
from tests.support.commands import PAGE_TOKEN, Started, page_url
from tests.tools.page.tables import name_of, state_of
from tests.tools.page.watching import Visitor


def test_values_are_shown_and_printed() -> None:
    mapping = Mapping(holding_registers=[range(3)])
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        what = ("read", running.urls[0], "holding", "0", "3", "--watch", "0.05")
        with Started(*what, "--page", "127.0.0.1:0", environment=PAGE_TOKEN) as process:
            with Visitor(page_url(process.stderr.readline())).watching() as visitor:
                assert visitor.seen["head"]["kind"] == "watch"
                assert running.urls[0] in visitor.seen["head"]["title"]
                visitor.look_at()
                visitor.receive(lambda: len(visitor.rows("rows")) == 4)
                rows = visitor.seen["rows"]
                visitor.receive(lambda: rows["3"]["value"]["text"] == "0")
                assert name_of(rows["3"]) == ["unit 1", "holding 2"]
                mapping.holding_registers[2] = 77
                visitor.receive(lambda: rows["3"]["value"]["text"] == "77")
                assert rows["3"]["highest"] == "77"
                assert process.stdout.readline().endswith("  0 0 0\n")
            process.send_signal(signal.SIGINT)
            process.wait()


ITEM = Item("holding_registers", 7, 1, word="holding")
GOOD = ReadResult(ITEM, [ValueText("    7", "5", "5")], {})


def test_a_failed_read_is_a_gap_with_its_reason() -> None:
    watch = ShownWatch("meter", 1.0)
    assert watch.status() == ("no answer yet", True)
    watch.print(3, [], "no answer")
    assert cells(watch) == [[["unit 3"], "down", "no answer"]]
    for unit in (1, 2):
        watch.print(unit, [GOOD], "")
    assert watch.status() == ("no answer from unit 3", True)
    watch.print(2, [], "no answer")
    watch.print(1, [GOOD._replace(rows=[], failure="illegal data address")], "")
    assert cells(watch) == [
        [["unit 1"], "up", ""],
        [["unit 1", "holding 7"], "bad", "illegal data address"],
        [["unit 2"], "down", "no answer"],
        [["unit 2", "holding 7"], "down", ""],
    ]
    assert [row.is_problem for row in watch.rows()] == [False, True, True, False]
    bad = "values that are not good: 1 (unit 1 holding 7)"
    assert watch.status() == (f"no answer from unit 3, unit 2; {bad}", True)
    assert watch.figures() == {"polls": 5, "failed": 3}
    watch.print(1, [GOOD], "")
    assert watch.status() == ("no answer from unit 3, unit 2", True)
    assert [row.cells()["value"]["text"] for row in watch.rows()] == ["", "5", "", "-"]
    for unit in (2, 3):
        watch.print(unit, [GOOD], "")
    assert watch.status() == ("the device answers", False)


def test_an_item_that_was_refused_at_the_start_has_a_row_with_the_reason() -> None:
    watch = ShownWatch("meter", 1.0)
    refused = ReadResult(Item("holding_registers", 100, 1, word="hr"), [], {}, "illegal address")
    watch.print(1, [GOOD, refused], "")
    assert cells(watch)[1:] == [
        [["unit 1", "holding 7"], "good", ""],
        [["unit 1", "hr 100"], "bad", "illegal address"],
    ]
    watch.print(1, [GOOD, refused._replace(rows=[ValueText("  100", "9", "9")], failure="")], "")
    assert cells(watch)[2] == [["unit 1", "hr 100"], "good", ""]


def cells(watch: ShownWatch) -> list[list[Any]]:
    """Return the name, state and reason of each row."""
    return [[name_of(row.cells()), *state_of(row.cells())[:2]] for row in watch.rows()]


def test_a_total_that_fell_has_a_mark_for_one_poll() -> None:
    watch = ShownWatch("meter", 1.0)
    marks = []
    for result in (GOOD, GOOD._replace(has_fallen=True), GOOD):
        watch.print(1, [result], "")
        marks.append(state_of(watch.rows()[1].cells()))
    assert marks == [["good", "", 0], ["good", "fell", 0], ["good", "", 0]]


def test_a_queue_may_become_empty_and_long() -> None:
    watch = ShownWatch("meter", 1.0)
    for texts in (["5", "6"], [], ["7"], ["8", "9", "10"]):
        rows = [ValueText(f"{at}", text, text) for at, text in enumerate(texts)]
        watch.print(1, [GOOD._replace(rows=rows)], "")
        assert [row.cells()["value"]["text"] for row in watch.rows()[1:]] == (texts or ["5", "6"])
