"""
Pages of tables: rows that are looked at, searches, history, and names that are attacks.
"""

from __future__ import annotations

import time
from typing import Any

import pytest

from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.samples import MOST_BYTES
from libmodbus_py.tools.page.table_source import MOST_VISIBLE, TableSource
from libmodbus_py.tools.page.tables import ValuesTable, cell_text, value_text
from tests.support.cases import each_case
from tests.tools.page.tables import HOSTILE, Plant, visited
from tests.tools.page.watching import Visitor


def names(visitor: Visitor) -> list[str]:
    return [
        cells[0][1] for _, cells in sorted(visitor.seen["rows"].items(), key=lambda x: int(x[0]))
    ]


def test_rows_come_when_they_are_looked_at_and_change_when_their_values_do() -> None:
    plant = Plant()
    plant.values.describe([("meter", f"p{at}", "V") for at in range(500)])
    with visited(plant) as visitor:
        assert visitor.seen["title"] == "plant.toml"
        assert visitor.seen["tables"][0]["columns"][0][:2] == ["point", "row"]
        visitor.look_at("values", 100, 130)
        visitor.receive(lambda: len(visitor.seen["rows"]) == 30)
        assert visitor.seen["count"] == 500
        assert names(visitor)[0] == "p100"
        visitor.seen["rows"] = {}
        plant.put("meter", "p7", 1.0)  # out of sight
        plant.put("meter", "p101", 21.5)
        visitor.receive(lambda: visitor.seen["rows"])
        assert list(visitor.seen["rows"]) == ["101"]
        assert visitor.seen["rows"]["101"][1:3] == ["21.5", "V"]


def test_a_view_that_is_looked_at_again_is_sent_whole() -> None:
    plant = Plant()
    plant.values.describe([("meter", f"p{at}", "V") for at in range(500)])
    with visited(plant) as visitor:
        for _ in range(2):
            visitor.look_at("values", 100, 130)
            visitor.receive(lambda: len(visitor.seen["rows"]) == 30)
            visitor.seen["rows"] = {}


def test_a_view_has_a_bounded_number_of_rows() -> None:
    plant = Plant()
    plant.values.describe([("meter", f"p{at}", "V") for at in range(1000)])
    with visited(plant) as visitor:
        visitor.look_at("values", 0, 10_000_000)
        visitor.receive(lambda: visitor.seen["rows"])
        assert len(visitor.seen["rows"]) == MOST_VISIBLE


def test_rows_are_found_by_words_and_by_trouble() -> None:
    plant = Plant()
    plant.values.describe([(f"meter {at}", name, "V") for at in range(9) for name in ("Load", "I")])
    for at in range(9):
        plant.put(f"meter {at}", "Load", at)
    plant.put("meter 4", "Load", None, quality="down", reason="ModbusTimeoutError")
    with visited(plant) as visitor:
        visitor.look_at("values", find="meter LOAD")
        visitor.receive(lambda: visitor.seen.get("count") == 9)
        visitor.look_at("values", trouble=True)
        visitor.receive(lambda: visitor.seen["count"] == 1 and visitor.seen["rows"])
        assert visitor.seen["rows"]["0"][6] == ["down", "ModbusTimeoutError"]
        plant.put("meter 4", "Load", 3)
        visitor.receive(lambda: visitor.seen["count"] == 0)


def test_devices_that_are_replaced_vanish_and_their_history_stays_with_those_that_do_not() -> None:
    plant = Plant()
    plant.values.describe([("a", "x", "V"), ("b", "x", "V")])
    plant.put("a", "x", 1)
    plant.put("b", "x", 2)
    with visited(plant) as visitor:
        visitor.look_at("values")
        visitor.receive(lambda: visitor.seen.get("count") == 2)
        plant.values.describe([("b", "x", "A"), ("c", "x", "V")])
        plant.put("a", "x", 5)  # a reading that was under way
        visitor.receive(lambda: visitor.seen["rows"].get("0", [["", ""]])[0][0] == "b")
        assert visitor.seen["rows"]["0"][1:3] == ["2", "A"]
        assert visitor.history(row=["b", "x"], seconds=60)["values"] == [2]
        gone = visitor.history(row=["a", "x"], seconds=60)
        assert gone == "this value no longer exists"


def test_history_is_that_of_memory_and_before_it_that_of_the_journal() -> None:
    asked: list[Any] = []
    now = time.time()

    def older(device: str, name: str, since: float, until: float, most: int) -> Any:
        asked.append((device, name, round(until - since), most > 0))
        return [(now - 3000, 1.0), (now - 2000, None), (now - 50, 2.0), (now - 5, 99.0)]

    plant = Plant(older=older)
    plant.values.describe([("a", "x", "V")])
    for at in range(40):
        plant.put("a", "x", 100 + at, now - 40 + at)
    with visited(plant) as visitor:
        found = visitor.history(row=["a", "x"], seconds=3600)
    assert asked == [("a", "x", 3560, True)]
    assert found["values"] == [1.0, None, 2.0, *range(100, 140)]
    assert len(found["times"]) == len(found["values"])
    assert found["units"] == "V"


@each_case(
    ("request_", "said"),
    [
        ({"table": "none"}, "there is no such table"),
        ({"table": ["values"]}, "there is no such table"),
        ({"table": "__proto__"}, "there is no such table"),
        ({"find": 5}, "find must be a string"),
        ({"find": "x" * 101}, "find must be a string of at most 100 characters"),
        ({"first": -1}, "first must be in"),
        ({"stop": "9"}, "stop must be an integer"),
        ({"stream": "none"}, "this page is no longer open"),
    ],
)
def test_wrong_views_are_refused(request_: dict[str, Any], said: str) -> None:
    with visited(Plant()) as visitor:
        view = {"table": "values", "find": "", "trouble": False, "first": 0, "stop": 9}
        given = {"stream": visitor.seen["stream"], **view, **request_}
        assert said in visitor.post("/view", **given)


@each_case(
    ("row", "seconds"),
    [(["a"], 5), ("ab", 5), ([1, 2], 5), ([["a"], "x"], 5), (["a", "x"], 0), (["a", "x"], "1")],
)
def test_wrong_histories_are_refused(row: Any, seconds: Any) -> None:
    plant = Plant()
    plant.values.describe([("a", "x", "V")])
    with visited(plant) as visitor:
        assert isinstance(visitor.history(row=row, seconds=seconds), str)


@each_case(
    ("table", "column"),
    [("none", "x"), (["values"], "x"), ("__proto__", "x"), ("values", 1), ("values", None)],
)
def test_charts_of_what_is_no_sparkline_are_refused(table: Any, column: Any) -> None:
    plant = Plant()
    plant.values.describe([("a", "x", "V")])
    with visited(plant) as visitor:
        assert isinstance(visitor.history(["a", "x"], 5, table, column), str)


def test_long_names_are_cut_and_hostile_ones_arrive_as_text() -> None:
    plant = Plant(title="<b>" + "t" * 1_000_000)
    given = [*HOSTILE, "n" * 1_000_000]
    plant.values.describe([(name, name, name) for name in given])
    for name in given:
        plant.put(name, name, name, reason=name)
    with visited(plant) as visitor:
        visitor.look_at("values")
        visitor.receive(lambda: visitor.seen.get("count") == len(given))
        visitor.receive(lambda: len(visitor.seen["rows"]) == len(given))
        assert len(visitor.seen["title"]) < 300
        assert names(visitor)[0] == HOSTILE[0]
        assert len(str(visitor.seen["rows"])) < 20_000
        assert visitor.history(row=["__proto__"] * 2, seconds=5)["values"] == [None]


@each_case(
    ("value", "text"),
    [
        (True, "on"),
        (230.1, "230.1"),
        (5.621819019317627, "5.621819"),
        (42949672.95, "42949672.95"),
        (1e300, "1e+300"),
        (None, "None"),
        ([1.5, None, False], "1.5, -, off"),
        ({"alarm": True, "fault": False}, "alarm=on fault=off"),
        (10**30, str(10**30)),
        ("a\x1b[2Jb", "a?[2Jb"),
        ("x" * 300, "x" * 200 + "..."),
        (list(range(99)), ", ".join(map(str, range(20))) + ", ..."),
    ],
)
def test_values_as_text(value: Any, text: str) -> None:
    assert value_text(value) == text
    assert cell_text(text) == text or len(text) > 200


def test_the_samples_of_many_values_take_a_bounded_memory() -> None:
    values = ValuesTable()
    values.describe([("a", str(at), "") for at in range(20_000)])
    for at in range(1000):
        values.put([(float(at), "a", "7", at)])
    series = values.series(("a", "7"), "last values")
    assert series is not None
    assert len(series.samples) == MOST_BYTES // 16 // 20_000


def test_two_pages_cannot_be_at_one_address() -> None:
    with table_page(TableSource(Plant())) as page:
        port = Visitor(page.url).address[1]
        with pytest.raises(OSError, match="Address already in use"):
            table_page(TableSource(Plant()), "127.0.0.1", port).__enter__()
