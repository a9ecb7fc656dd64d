"""Plans of devices that cannot read everything: what is left out, and what it costs."""

import random
from collections.abc import Iterable
from typing import Any

import pytest

from libmodbus_py.errors import IllegalDataAddress, ModbusError, ModbusTimeoutError
from libmodbus_py.maps.plan import Plan, unreadable_of
from tests.maps.refusing import H, Polls, Registers, lost, singles
from tests.support.cases import each_case


def test_both_halves_are_read_until_single_registers_are_known() -> None:
    polls = Polls(singles(8), Registers([2]))
    polls.poll()
    assert polls.device.asked == [(0, 8), (0, 4), (4, 4), (0, 2), (2, 2), (2, 1), (3, 1)]
    polls.device.asked.clear()
    polls.poll()
    assert polls.device.asked == [(0, 2), (3, 5)]


# Items, cells between them that may be read, what is missing, the items that are lost, and the
# requests of each later poll.
LOST: list[Any] = [
    pytest.param({at: (H, at) for at in range(300)}, 0, [], [], 3, id="nothing is missing"),
    pytest.param(
        {at: (H, 2 * at, 1, "uint32") for at in range(20)}, 0, [11], [5], 2, id="half a value"
    ),
    pytest.param({"long": (H, 0, 200), "next": (H, 200, 3)}, 0, [150], ["long"], 2, id="long"),
    pytest.param(
        {"both": (H, 4, 1, "uint32"), "a": (H, 4), "c": (H, 6)}, 0, [5], ["both"], 2, id="overlap"
    ),
    pytest.param({at: (H, at) for at in range(0, 60, 3)}, 2, [28], [], 2, id="in no item"),
]


@each_case(("items", "gap", "missing", "lost_ones", "later"), LOST)
def test_items_without_refused_cells_have_values(items, gap, missing, lost_ones, later) -> None:
    plan = Plan(items, gap=gap)
    polls = Polls(plan, Registers(missing))
    for _ in range(3):
        polls.device.asked.clear()
        count, values = polls.poll()
        spans = [range(first, first + size) for first, size in polls.device.asked]
        names = [name for name, value in values.items() if isinstance(value, ModbusError)]
        assert names == polls.unreadable == lost_ones
        for name in values.keys() - names:
            cells = plan._reads[name].cells
            assert values[name] == plan._reads[name].decode(list(cells))
            assert any(cells[0] in span and cells[-1] in span for span in spans), "torn"
    assert count == later


def test_an_item_that_cannot_be_read_is_named_with_its_cells() -> None:
    polls = Polls(Plan({"v5": (H, 10, 1, "uint32")}), Registers([11]))
    polls.poll()
    assert [str(name) for name in unreadable_of(polls.plan, polls.refusals, "device")] == [
        "v5, holding_registers 10..11 (2 registers): illegal data address (exception 2)"
    ]


def test_plans_of_one_unit_share_their_refusals() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll()
    polls.plan = Plan([(H, at) for at in (4, 5, 6)])
    count, values = polls.poll()
    assert (count, lost(values)) == (2, [1])


@each_case(
    "missing",
    [
        random.Random(1).sample(range(500), 40),
        [*range(100, 120), *range(300, 320)],
        range(60, 100),
        range(0, 500, 2),
    ],
)
def test_many_refused_registers_are_found_in_one_run(missing: Iterable[int]) -> None:
    polls = Polls(singles(500), Registers(missing))
    first, values = polls.poll()
    assert lost(values) == sorted(missing)
    assert first <= 2 * 500
    assert polls.poll()[0] <= len(set(missing)) + 4
    assert lost(polls.poll()[1]) == sorted(missing)


@pytest.mark.slow
@each_case("count", [1, 2, 7, 20, 300])
def test_a_device_that_refuses_everything_is_asked_once_in_a_run(count: int) -> None:
    polls = Polls(singles(count), Registers(range(65536)))
    first, values = polls.poll(0)
    # The search ends early while nothing is answered.
    assert first <= -(-count // 125) + 17
    assert lost(values) == polls.unreadable == list(range(count))
    assert [polls.poll(now)[0] for now in range(1, 700)] == [1] * 699
    polls.device.missing = set()
    _, values = polls.poll(700)
    assert lost(values) == []
    assert polls.unreadable == []
    assert polls.poll(701) == (-(-count // 125), [[at] for at in range(count)])


def test_a_device_that_refuses_everything_is_not_searched_again_in_the_next_run() -> None:
    """Of 2000 coils two are found, by two requests for each of 11 halvings; then none is read."""
    polls = Polls(Plan([("coils", at) for at in range(2000)]), Registers(range(65536)))
    assert polls.requests(20) == [1 + 22] + [1] * 19


def test_a_missing_block_costs_two_requests_a_register_once() -> None:
    plan = Plan([(H, address) for address in (*range(100), *range(1000, 1100))])
    polls = Polls(plan, Registers(range(1000, 1100)))
    first, values = polls.poll()
    assert first == 1 + 2 * 100 - 1
    assert lost(values) == list(range(100, 200))
    assert polls.requests(5) == [1] * 5
    assert polls.news == [
        "100, 101, 102, ..., holding_registers 1000..1099 (100 registers): "
        "illegal data address (exception 2)"
    ]


@each_case("most", [1, 10, 50, 64, 124])
def test_a_device_that_takes_short_requests_only_loses_no_point(most: int) -> None:
    """A device that takes fewer registers in a request refuses as if one were missing."""
    polls = Polls(singles(300), Registers([7], most=most))
    for now in range(10):
        count, values = polls.poll(now)
        assert lost(values) == [7]
    assert count <= 2 * (300 // most + 2)


def test_adjacent_refused_registers_are_one_range() -> None:
    polls = Polls(singles(20), Registers([3, 4, 9]))
    polls.poll()
    assert [text.split(" (")[0] for text in polls.news] == [
        "3, 4, holding_registers 3..4",
        "9, holding_registers 9",
    ]


def test_a_refused_register_is_tried_again_every_ten_minutes() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    times = [now for now in range(1, 2000) if polls.poll(now)[0] > 2]
    assert times == [600, 1200, 1800]
    assert len(polls.news) == 1


def test_each_run_tries_one_refused_register_again() -> None:
    polls = Polls(singles(20), Registers([5, 9, 13]))
    polls.poll(0)
    polls.device.asked.clear()
    counts = [polls.poll(now)[0] for now in range(598, 605)]
    assert counts == [4, 4, 5, 5, 5, 4, 4]
    for address in (5, 9, 13):
        assert polls.device.asked.count((address, 1)) == 1


def test_a_refused_register_that_answers_is_read_at_once() -> None:
    polls = Polls(singles(20), Registers([5, 9, 13]))
    polls.poll(0)
    polls.device.missing = {13}
    count, values = polls.poll(600)
    # Three portions and a trial; as that is answered, the other two.
    assert count == 4 + 1 + 2
    assert lost(values) == [13]
    assert polls.poll(601)[0] == 2
    assert polls.unreadable == [13]


def test_a_new_connection_causes_a_new_trial() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    counts = []
    for now in range(1, 7):
        polls.connects = 1 + now // 3
        counts.append(polls.poll(now)[0])
    assert counts == [2, 2, 3, 2, 2, 3]


def test_the_first_connection_causes_no_new_trial() -> None:
    """The connection is made by the first request."""
    polls = Polls(singles(20), Registers([5]))
    polls.connects = 0
    polls.poll(0)
    polls.connects = 1
    assert polls.poll(1)[0] == 2


def test_a_trial_without_an_answer_counts_as_a_trial() -> None:
    polls = Polls(singles(20), Registers([5]))
    polls.poll(0)
    silent = Registers([5], refusal=ModbusTimeoutError)
    polls.device = silent
    assert [polls.poll(now)[0] for now in (600, 601)] == [3, 2]
    assert isinstance(unreadable_of(polls.plan, polls.refusals, "")[0].error, IllegalDataAddress)


def test_a_shorter_request_is_tried_again_too() -> None:
    polls = Polls(singles(100), Registers(most=60))
    assert polls.requests(3) == [3, 2, 2]
    polls.device.most = 125
    assert [polls.poll(now)[0] for now in (599, 600, 601)] == [2, 1, 1]
