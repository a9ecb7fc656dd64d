"""
The samples of a value: bounded, with gaps, in the order of time, and their extremes; and numbers of
rows over time, made of counters.
"""

from collections.abc import Iterable
from typing import Any

from libmodbus_py.tools.page.samples import Counts, RowHistory, Samples, with_gaps
from tests.support.cases import each_case


def sampled(points: Iterable[tuple[float, Any]], *options: Any) -> Samples:
    """Return samples of values at times."""
    samples = Samples(*options)
    for time, value in points:
        samples.add(time, value)
    return samples


def made(*values: Any, most: int = 10) -> Samples:
    """Return samples of a value in each second."""
    return sampled(enumerate(values, 100), None, most)


def test_the_latest_samples_and_the_extremes_of_all_are_kept() -> None:
    samples = made(50, *range(30), most=4)
    assert samples.pairs() == [(127, 26), (128, 27), (129, 28), (130, 29)]
    assert samples.pairs(since=128) == [(129, 28), (130, 29)]
    assert (samples.low, samples.high, len(samples.pairs())) == (0, 50, 4)
    samples.resize(2)
    samples.add(131, 7)
    assert samples.pairs() == [(130, 29), (131, 7)]


def test_a_sparkline_has_the_last_samples_in_20_levels() -> None:
    assert made(*range(80), most=70).spark() == [at * 20 // 59 for at in range(60)]
    assert made(*range(13), most=4).spark() == [0, 6, 13, 20]
    assert made(True, False, True).spark() == [20, 0, 20]
    assert made(5, 5, None).spark() == [10, 10, -1]
    assert made(None, None).spark() == []
    assert made(-1e308, 1e308).spark() == [10, 10]  # the span is not a number


def test_a_sample_soon_after_another_replaces_it_but_a_gap_never_does() -> None:
    samples = sampled([(1.0, 5), (1.1, 9), (1.2, None), (2.0, None), (2.1, 4)])
    assert samples.pairs() == [(1.0, 9), (2.0, 4)]
    assert (samples.low, samples.high) == (4, 9)


@each_case(
    ("every", "values"),
    [
        (1.0, [1, 2, None, 3]),  # nothing came for three seconds and more
        (2.0, [1, 2, 3]),
        (None, [1, 2, 3]),  # it came when it changed
    ],
)
def test_a_period_without_samples_is_a_gap(every: float | None, values: list[float | None]) -> None:
    points = [(1.0, 1.0), (2.0, 2.0), (5.5, 3.0)]
    samples = sampled(points, every)
    assert [sample for _, sample in samples.pairs()] == values
    assert samples.spark().count(-1) == values.count(None)
    assert [point for _, point in with_gaps([*points], every)] == values


def test_samples_and_gaps_are_in_the_order_of_time() -> None:
    set_back = [(50, 1), (60, 2), (10, 3), (11, 4)]
    assert sampled(set_back).pairs() == sorted(set_back)
    with_a_gap = [(1, 1), (2, None), (900, None), (5000, 2)]
    assert sampled(with_a_gap, 1.0).pairs() == with_a_gap


Name = tuple[str, str]
LINE = "", "tcp://192.0.2.1"


class Counters:
    """Counters of rows that a test changes, and a clock that it moves."""

    def __init__(self, counts: Counts = Counts(0)) -> None:  # noqa: B008  # it does not change
        self.now = 1000.0
        self.counts: dict[Name, Counts] = {LINE: counts}
        self.history = RowHistory(lambda: self.counts.items(), lambda: self.now)
        self.history.sample()

    def go_on(self, seconds: float, requests: int, name: Name = LINE) -> None:
        self.set(seconds, Counts(self.counts[name].requests + requests), name)

    def set(self, seconds: float, counts: Counts, name: Name = LINE) -> None:
        self.now += seconds
        self.counts[name] = counts
        self.history.sample()

    def numbers(self, name: Name = LINE, column: str = "rate") -> list[tuple[float, float | None]]:
        series = self.history.series(name, column)
        return [] if series is None else series.samples.pairs()


def test_a_rate_is_the_change_divided_by_the_seconds_since_the_last_sample() -> None:
    counters = Counters()
    for seconds, requests in ((1.0, 50), (0.25, 10), (0.25, 10), (1.5, 30), (3.0, 0)):
        counters.go_on(seconds, requests)
    assert counters.numbers() == [(1001.0, 50.0), (1003.0, 25.0), (1006.0, 0.0)]
    assert counters.history.spark(LINE, "rate") == [20, 10, 0]
    counters.go_on(94, 47)  # there were neither requests nor pages
    assert counters.numbers()[-2:] == [(1006.4, None), (1100.0, 0.5)]


def test_rates_are_computed_over_the_time_between_samples() -> None:
    counters = Counters(Counts(100, 90, 2.0, 5))
    counters.set(3.0, Counts(130, 100, 2.2, 1))
    counters.set(3.0, Counts(131, 101, 2.2012345, 2))
    counters.set(1.0, Counts(131, 101, 2.2012345, None))
    counters.set(1.0, Counts(5, 1, 0.1, 0))  # after a change of routes counters may begin again
    for column, numbers in (
        ("rate", [10.0, 0.33, 0, 0]),
        ("time", [20.0, 1.23, None, None]),
        ("queue", [1, 2, None, 0]),
    ):
        assert [number for _, number in counters.numbers(LINE, column)] == numbers
