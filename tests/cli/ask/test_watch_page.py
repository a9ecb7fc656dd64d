"""
read --watch --page: the values in a browser too, while they are printed as without it.
"""

from __future__ import annotations

import signal

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.ask.formatters import FormattedValue, ReadResult, formatter_of
from libmodbus_py.cli.ask.items import Item
from libmodbus_py.cli.ask.shown_watch import ShownWatch
from tests.support.commands import Started, run
from tests.tools.page.watching import Visitor


def test_values_are_shown_and_printed() -> None:
    mapping = Mapping(holding_registers=[range(3)])
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        what = ("read", running.urls[0], "holding", "0", "3", "--watch", "0.05")
        with Started(*what, "--page", "127.0.0.1:0") as process:
            line = process.stderr.readline()
            assert line.startswith("page on ")
            with Visitor(line.split()[-1]).watching() as visitor:
                assert visitor.seen["kind"] == "watch"
                assert running.urls[0] in visitor.seen["title"]
                visitor.look_at("values")
                rows = visitor.seen["rows"]
                visitor.receive(lambda: rows.get("2", [0, 0])[1] == "0")
                assert rows["2"][0] == ["unit 1", "holding 2"]
                mapping.holding_registers[2] = 77
                visitor.receive(lambda: rows["2"][1] == "77")
                assert rows["2"][5] == "77"  # the highest
                assert process.stdout.readline().endswith("  0 0 0\n")
            process.send_signal(signal.SIGINT)
            process.wait()


def test_a_page_implies_watching_and_a_token_needs_a_page() -> None:
    done = run("read", "tcp://127.0.0.1:9", "holding", "0", "--watch", "1", "--page-token", "file")
    assert (done.code, "--page-token needs --page" in done.err) == (2, True)


class Silent:
    """Prints nothing."""

    def print(self, unit: int, results: object) -> None:
        """Take it."""

    def fail(self, unit: int, reason: str) -> None:
        """Take it."""


def test_what_fails_is_a_gap_with_its_reason() -> None:
    shown = ShownWatch("meter", Silent())
    formatter = formatter_of(Item("holding_registers", 7, 1), as_all=False, in_hex=False)
    good = ReadResult(formatter, [FormattedValue("    7", "5", "5")], {})
    (values,) = shown.tables
    for unit in (1, 2):
        shown.print(unit, [good])
    shown.fail(2, "no answer")
    shown.print(1, [good._replace(rows=[], failure="illegal data address")])
    assert [values.cells(row)[6] for row in values.rows()] == [
        ["bad", "illegal data address"],
        ["down", "no answer"],
    ]
    assert shown.figures() == {"polls": 4, "failed": 2}
    shown.print(1, [good])
    assert [values.cells(row)[1] for row in values.rows()] == ["5", "-"]


def test_a_total_that_fell_has_a_mark_for_one_poll() -> None:
    shown = ShownWatch("meter", Silent())
    formatter = formatter_of(Item("holding_registers", 7, 1), as_all=False, in_hex=False)
    good = ReadResult(formatter, [FormattedValue("    7", "5", "5")], {})
    (values,) = shown.tables
    found = []
    for result in (good, good._replace(has_fallen=True), good):
        shown.print(1, [result])
        found += [values.cells(row)[6] for row in values.rows()]
    assert found == [["good", ""], ["good", "Fell"], ["good", ""]]
