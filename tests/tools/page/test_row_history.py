"""
Numbers of rows over time, made of counters.
"""

from __future__ import annotations

import threading

from libmodbus_py.tools.page.row_history import RowHistory
from libmodbus_py.tools.page.samples import MOST_BYTES, MOST_SAMPLES

Name = tuple[str, str]
LINE = "", "tcp://192.0.2.1"


class Counters:
    """Counters of rows that a test changes, and a clock that it moves."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.counts: dict[Name, int] = {LINE: 0}
        self.history = RowHistory(
            lambda: list(self.counts.items()),
            lambda count: count,
            lambda before, now, passed: {"rate": (now - before) / passed},
            {"rate": "1/s"},
            lambda: self.now,
        )

    def go_on(self, seconds: float, requests: int, name: Name = LINE) -> None:
        self.now += seconds
        self.counts[name] += requests
        self.history.sample()

    def numbers(self, name: Name = LINE) -> list[tuple[float, float | None]]:
        series = self.history.series(name, "rate")
        return [] if series is None else series.samples.pairs()


def test_a_number_is_what_changed_in_the_seconds_since_the_last_sample() -> None:
    counters = Counters()
    counters.history.sample()
    for seconds, requests in ((1.0, 50), (2.0, 50), (4.0, 0)):
        counters.go_on(seconds, requests)
    assert counters.numbers() == [(1001.0, 50.0), (1003.0, 25.0), (1007.0, 0.0)]
    series = counters.history.series(LINE, "rate")
    assert series is not None
    assert series.units == "1/s"
    assert counters.history.spark(LINE, "rate") == [20, 10, 0]


def test_samples_are_a_second_apart_and_count_all_between() -> None:
    counters = Counters()
    counters.history.sample()
    for _ in range(12):
        counters.go_on(0.25, 1)
    assert counters.numbers() == [(1001.0, 4.0), (1002.0, 4.0), (1003.0, 4.0)]


def test_rows_come_and_go() -> None:
    counters = Counters()
    counters.history.sample()
    counters.go_on(1, 5)
    other = "", "tcp://192.0.2.2"
    counters.counts[other] = 1_000_000  # it counted before it was seen
    counters.go_on(1, 5)
    counters.go_on(1, 7, other)
    assert counters.numbers(other) == [(1003.0, 7.0)]
    del counters.counts[LINE]
    counters.now += 1
    counters.history.sample()
    assert counters.history.series(LINE, "rate") is None
    assert counters.history.spark(LINE, "rate") == []


def test_a_clock_that_is_set_back_makes_no_number_and_stops_none() -> None:
    counters = Counters()
    counters.history.sample()
    counters.go_on(1, 10)
    counters.go_on(-3600, 10)
    counters.go_on(1, 10)
    assert sorted(number or 0 for _, number in counters.numbers()) == [10, 10]


def test_all_rows_together_take_a_bounded_room() -> None:
    counters = Counters()
    counters.counts = {("", str(at)): 0 for at in range(20_000)}
    for _ in range(3):
        counters.go_on(1, 1, ("", "0"))
    series = counters.history.series(("", "7"), "rate")
    assert series is not None
    for at in range(MOST_SAMPLES):
        series.samples.add(5000.0 + at, at)
    assert len(series.samples) * 16 * 20_000 <= MOST_BYTES


def test_threads_that_sample_at_once_count_nothing_twice() -> None:
    counters = Counters()
    counters.history.sample()
    threads = [threading.Thread(target=counters.history.sample) for _ in range(8)]
    counters.now += 1
    counters.counts[LINE] = 40
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counters.numbers() == [(1001.0, 40.0)]
