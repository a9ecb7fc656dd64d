"""Pages with a table: rows that are looked at, searches, problems, history, hostile names."""

import math
import time
from typing import Any

from libmodbus_py.tools.page.samples import MOST_BYTES
from libmodbus_py.tools.page.table_source import MOST_VISIBLE
from libmodbus_py.tools.page.text import value_text
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.tools.page.tables import HOSTILE, Plant, visited
from tests.tools.page.watching import Visitor


def names(visitor: Visitor) -> list[str]:
    return [cells["name"]["own"] for cells in visitor.rows("rows")]


def count(visitor: Visitor) -> Any:
    return visitor.seen.get("view", {}).get("count")


def test_rows_are_sent_when_in_view_and_when_their_values_change() -> None:
    plant = Plant()
    plant.describe(*(("meter", f"p{at}") for at in range(500)))
    with visited(plant) as visitor:
        assert visitor.seen["head"]["title"] == "plant.toml"
        column = {"title": "name", "kind": "row", "is_wide": False}
        assert visitor.seen["head"]["columns"][0] == column
        visitor.look_at(101, 131)
        visitor.receive(lambda: len(visitor.rows("rows")) == 30)
        assert count(visitor) == 501
        assert names(visitor)[0] == "p100"
        visitor.messages.clear()
        plant.put("meter", "p7", 1.0)  # out of sight
        plant.put("meter", "p101", 21.5)
        visitor.receive(lambda: visitor.seen["rows"]["102"]["value"]["text"] == "21.5")
        assert [list(message["rows"]) for message in visitor.messages] == [["102"]]


def test_rows_are_found_by_words() -> None:
    plant = Plant()
    plant.describe(*((f"meter {at}", name) for at in range(99) for name in ("Load", "I")))
    with visited(plant) as visitor:
        for find, rows in (("", 297), ("meter LOAD", 99), ("meter 44", 3)):
            visitor.look_at(0, 10_000_000, find=find)
            visitor.receive(lambda rows=rows: count(visitor) == rows)
            assert len(visitor.rows("rows")) == min(rows, MOST_VISIBLE)
        assert names(visitor) == ["meter 44", "Load", "I"]


def test_a_device_that_is_down_is_one_problem_with_a_readable_reason() -> None:
    plant = Plant()
    plant.describe(*((f"meter {at}", name) for at in range(9) for name in ("Load", "I")))
    for at in range(9):
        plant.put(f"meter {at}", "Load", at)
    plant.put("meter 2", "I", None, reason="IllegalDataAddress")
    for name in ("Load", "I"):
        plant.put("meter 4", name, None, quality="down", reason="ModbusTimeoutError")
    plant.meters["meter 4"].reason = "no answer within 0.5 s"
    with visited(plant) as visitor:
        visitor.look_at(problems=True)
        visitor.receive(lambda: count(visitor) == 2)
        assert [(cells["name"], cells["state"]) for cells in visitor.rows("rows")] == [
            ({"group": "meter 2", "own": "I"}, {"word": "bad", "reason": "illegal data address"}),
            (
                {"group": "", "own": "meter 4"},
                {"word": "down", "reason": "no answer within 0.5 s", "since": 1000.0},
            ),
        ]
        plant.put("meter 2", "I", 3)
        plant.meters["meter 4"].reason = ""
        plant.put("meter 4", "Load", 3)
        plant.put("meter 4", "I", 3)
        visitor.receive(lambda: count(visitor) == 0)


def test_replaced_devices_disappear_and_others_keep_their_history() -> None:
    plant = Plant()
    plant.describe(("a", "x"), ("b", "x"))
    plant.put("a", "x", 1)
    plant.put("b", "x", 2)
    with visited(plant) as visitor:
        visitor.look_at()
        visitor.receive(lambda: count(visitor) == 4)
        plant.describe(("b", "x"), ("c", "x"))
        plant.put("a", "x", 5)  # a reading that was under way
        visitor.receive(lambda: names(visitor) == ["b", "x", "c", "x"])
        assert visitor.seen["rows"]["1"]["value"] == {"text": "2", "units": "V"}
        assert visitor.history(row=["b", "x"], seconds=60)["values"] == [2]
        history = visitor.history(row=["a", "x"], seconds=60)
        assert history == "this value no longer exists"


@each_case(
    ("every", "before"),
    [(10.0, [1.0, 2.0, None, 3.0, None]), (300.0, [1.0, 2.0, 3.0, None]), (None, [1.0, 2.0, 3.0])],
)
def test_history_comes_from_memory_and_before_that_from_the_journal(every, before):
    queries: list[Any] = []
    now = time.time()

    def older(device: str, name: str, since: float, until: float, most: int) -> Any:
        queries.append((device, name, round(until - since), most > 0))
        return [(now - 3000, 1.0), (now - 2995, 2.0), (now - 2500, 3.0), (now - 5, 99.0)]

    plant = Plant(older=older)
    plant.describe(("a", "x"), every=every)
    for at in range(40):
        plant.put("a", "x", 100 + at, now - 40 + at)
    with visited(plant) as visitor:
        history = visitor.history(row=["a", "x"], seconds=3600)
    assert queries == [("a", "x", 3560, True)]
    assert history["values"] == [*before, *range(100, 140)]
    assert len(history["times"]) == len(history["values"])
    assert history["units"] == "V"


def test_a_chart_has_numbers_up_to_now_and_gaps() -> None:
    now = time.time()
    odd = (math.inf, math.nan, 10**400, None)
    older = [(now - 9, 1.0), *((now - 8 + at, value) for at, value in enumerate(odd))]
    plant = Plant(older=lambda *_: older)
    plant.describe(("a", "x"), every=None)
    plant.put("a", "x", 3.0, now + 3600)  # the clock was set back
    for at, value in enumerate([-math.inf, math.nan, 10**400, "<script>", 2.0]):
        plant.put("a", "x", value, now - 4 + at)
    with visited(plant) as visitor:
        history = visitor.history(row=["a", "x"], seconds=60)
    assert history["values"] == [1.0, *[None] * 8, 2.0]


def test_wrong_requests_are_refused(refused: Refused) -> None:
    plant = Plant()
    plant.describe(("a", "x"))
    with visited(plant) as visitor:
        right = {"find": "", "problems": False, "first": 0, "stop": 9, "row": ["a", "x"]}
        right |= {"stream": visitor.seen["page"]["stream"], "column": "last values", "seconds": 5}
        refused("refused_tables.txt", lambda row: visitor.refused((row[0], right | row[1])))


def test_long_names_are_shortened_and_hostile_ones_arrive_as_text() -> None:
    plant = Plant(title="<b>" + "t" * 1_000_000)
    texts = [*HOSTILE, "n" * 1_000_000]
    plant.describe(*((name, name) for name in texts))
    for name in texts:
        plant.put(name, name, name, reason=name)
    with visited(plant) as visitor:
        visitor.look_at()
        visitor.receive(lambda: count(visitor) == 2 * len(texts))
        assert names(visitor)[0] == HOSTILE[0]
        assert len(str(visitor.seen)) < 20_000
        assert visitor.history(row=["__proto__"] * 2, seconds=5)["values"] == [None]


@each_case(
    ("value", "text"),
    [
        (True, "on"),
        (230.1, "230.1"),
        (5.621819019317627, "5.621819"),
        (42949672.95, "42949672.95"),
        (1e300, "1e+300"),
        (math.nan, "nan"),
        (-math.inf, "-inf"),
        (10**400, f"{'1'.ljust(200, '0')}..."),
        (None, "None"),
        ([1.5, None, math.nan], "1.5, -, nan"),
        ({"alarm": True, "fault": False}, "alarm=on fault=off"),
        ("a\x1b[2J\ud800b", "a?[2J?b"),
        (b"x", "b'x'"),
        ("x" * 300, "x" * 200 + "..."),
        (list(range(99)), ", ".join(map(str, range(20))) + ", ..."),
    ],
)
def test_values_are_converted_to_text(value: Any, text: str) -> None:
    assert value_text(value) == text


def test_the_samples_of_many_values_take_a_bounded_memory() -> None:
    plant = Plant()
    plant.describe(*(("a", str(at)) for at in range(20_000)))
    for at in range(1000):
        plant.put("a", "7", at, float(at))
    samples = plant.series(("a", "7"), "last values").samples
    assert len(samples.pairs()) == MOST_BYTES // 16 // 20_000
