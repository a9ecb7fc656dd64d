"""A line of a gateway in simulated time: who is asked when, and who is told what."""

import asyncio
import logging

import pytest

from libmodbus_py.services.gateway import line as gateway_line
from libmodbus_py.services.gateway.line import BUSY, MOST_CACHED, NO_ANSWER, Cache, ForwardedRequest
from tests.services.gateway.gates import (
    INPUTS,
    LINE,
    READ,
    REFUSED,
    TIMEOUT,
    UNKNOWN,
    WRITE,
    Asker,
    Plant,
    answer_of,
    on_line,
)
from tests.simulation import network
from tests.support.cases import each_case

TOLD = "libmodbus_py.services.gateway"


def logged(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return what was logged, without the names of lines."""
    return [text.partition(": ")[2] for text in caplog.messages]


@on_line()
async def test_a_silent_unit_is_paused_and_then_tried_with_one_request(plant: Plant, caplog):
    caplog.set_level(logging.INFO, logger=TOLD)
    plant.silent.add(9)
    first, second, third = Asker(), Asker(), Asker()
    plant.ask(9, first)
    plant.ask(9, second, INPUTS)
    await asyncio.sleep(TIMEOUT + 0.1)
    # Requests that wait for the same unit are refused at once.
    assert first.answers == [REFUSED]
    assert second.answers == [f"84{NO_ANSWER:02x}"]
    plant.ask(9, third)
    assert third.answers == [f"code {NO_ANSWER}"]
    assert (plant.unit(9).timeouts, plant.unit(9).refused) == (1, 2)
    assert plant.unit(9).is_silent
    plant.silent.clear()
    await asyncio.sleep(2 * TIMEOUT)
    plant.ask(9, first)
    plant.ask(9, second)
    assert second.answers[1:] == [f"code {NO_ANSWER}"]
    await asyncio.sleep(1)
    assert first.answers[1:] == [answer_of(9, 2)]
    assert not plant.unit(9).is_silent
    assert logged(caplog) == [
        f"unit 9 does not answer: no answer within {TIMEOUT:g} s",
        "unit 9 answers again",
    ]


@on_line()
async def test_a_refused_response_is_logged_with_its_reason(plant: Plant, caplog) -> None:
    plant.damaging.add(9)
    plant.ask(9, Asker())
    await asyncio.sleep(1)
    assert logged(caplog) == ["unit 9: bytes without a fitting CRC"]


@on_line("tcp://10.0.0.1?timeout=0.5")
async def test_a_trial_whose_connection_is_lost_is_followed_by_a_longer_pause(plant: Plant) -> None:
    plant.silent.add(9)
    plant.ask(9, Asker())
    await asyncio.sleep(2)
    trial, early, late = Asker(), Asker(), Asker()
    plant.ask(9, trial)
    await asyncio.sleep(0.1)
    plant.peer.drop_all()
    await asyncio.sleep(TIMEOUT)
    assert trial.answers == [REFUSED]
    plant.silent.clear()
    await asyncio.sleep(3 * TIMEOUT - 0.2)
    plant.ask(9, early)
    assert early.answers == [f"code {NO_ANSWER}"]
    await asyncio.sleep(2 * TIMEOUT)
    plant.ask(9, late)
    await asyncio.sleep(0.5)
    assert late.answers == [answer_of(9, 3)]


@on_line()
async def test_a_unit_without_an_answer_is_paused(plant: Plant, caplog) -> None:
    caplog.set_level(logging.INFO, logger=TOLD)
    asker = Asker()
    for request in (READ, UNKNOWN):
        plant.ask(9, asker, request)
        await asyncio.sleep(1)
    plant.unanswered = {3, 4, 8}
    plant.ask(9, asker, UNKNOWN)
    await asyncio.sleep(TIMEOUT + 0.1)
    assert not plant.unit(9).is_silent
    plant.ask(9, asker, READ)
    plant.ask(9, asker, INPUTS)
    await asyncio.sleep(2 * TIMEOUT + 0.1)
    assert plant.unit(9).is_silent
    assert plant.asked.count(-4) == 0  # nothing of the unit was answered any more
    plant.unanswered = set()
    await asyncio.sleep(2 * TIMEOUT)
    plant.ask(9, asker)
    await asyncio.sleep(0.4)
    assert not plant.unit(9).is_silent
    plant.ask(9, asker, UNKNOWN)  # the function is paused no longer than its unit
    await asyncio.sleep(1)
    assert asker.answers[-1] == "0800000001"
    assert logged(caplog) == [
        f"unit 9 does not answer function 8: no answer within {TIMEOUT:g} s",
        f"unit 9 does not answer: no answer within {TIMEOUT:g} s",
        "unit 9 answers again",
    ]


@on_line()
async def test_requests_of_a_silent_function_are_refused_together_until_it_answers(
    plant: Plant, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger=TOLD)
    plant.unanswered = {8}
    reader, asker = Asker("192.0.2.1"), Asker("192.0.2.2")
    plant.ask(9, reader)
    await asyncio.sleep(1)
    for request, entry in ((UNKNOWN, asker), (UNKNOWN, asker), (READ, reader)):
        plant.ask(9, entry, request)
    await asyncio.sleep(3 * TIMEOUT)
    assert asker.answers == [f"88{NO_ANSWER:02x}"] * 2
    assert plant.asked == [9, -8, 9]
    assert len(reader.answers) == 2
    plant.unanswered = set()
    for _ in range(2):
        plant.ask(9, asker, UNKNOWN)
        await asyncio.sleep(1)
    assert asker.answers[2:] == ["0800000001", "0800000001"]
    assert logged(caplog)[-1] == "unit 9 answers function 8 again"


@on_line()
async def test_a_lost_request_is_no_silence_and_the_unit_is_tried_again(plant: Plant):
    """A device that is to listen only says nothing (application protocol, 6.8.1)."""
    plant.silent.add(9)
    plant.ask(9, Asker())
    await asyncio.sleep(2)
    other, asker = Asker(), Asker()
    for unit in (1, 9):
        plant.ask(unit, other, "08 0004 0000")
        await asyncio.sleep(1)
    assert other.answers == [None, None]
    assert (plant.unit(1).timeouts, plant.unit(1).answers) == (0, 0)
    plant.silent.clear()
    plant.ask(9, asker)
    await asyncio.sleep(1)
    assert asker.answers == [answer_of(9, 4)]


@pytest.mark.parametrize(("connecting", "is_silent"), [(0.4, True), (0.6, False)])
@on_line("tcp://10.0.0.1?timeout=1")
async def test_a_unit_that_had_less_than_half_of_the_timeout_is_not_silent(
    plant: Plant, connecting: float, is_silent: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Because the connection took most of it."""
    monkeypatch.setattr(network, "CONNECTING", connecting)
    plant.silent.add(1)
    plant.ask(1, Asker())
    await asyncio.sleep(1.5)
    assert (plant.unit(1).timeouts, plant.unit(1).is_silent) == (1, is_silent)


@on_line(f"{LINE}?timeout=2")
async def test_a_damaged_answer_delays_only_its_unit(plant: Plant) -> None:
    """The line must be silent before that unit is asked again; others need not wait for it."""
    plant.damaging = {1}
    asker = Asker()
    plant.ask(1, asker)
    await asyncio.sleep(0.1)
    assert asker.answers == [REFUSED]
    damaged_at = plant.peer.times[0] + plant.delay
    for unit in (1, 2):
        plant.ask(unit, Asker())
    await asyncio.sleep(1)
    plant.ask(3, Asker())
    await asyncio.sleep(2)
    assert plant.asked == [1, 2, 3, 1]
    since = [at - damaged_at for at in plant.peer.times[1:]]
    assert since == pytest.approx([0.05, 1.05, 2.0], abs=0.05)


@on_line(longest_wait=0.01)
async def test_a_client_may_leave_while_it_gets_a_response(plant: Plant) -> None:
    class Leaving(Asker):
        def take_response(self, forwarded: ForwardedRequest, response: bytes | None) -> None:
            super().take_response(forwarded, response)
            plant.line.leave(joined.pop())

    asker = Leaving()
    joined: list[ForwardedRequest] = []
    plant.ask(1, Asker())
    plant.ask(2, asker, merge=True)
    joined.append(plant.ask(2, asker, merge=True))
    await asyncio.sleep(1)
    assert asker.answers == [f"83{BUSY:02x}"]
    assert (plant.asked, plant.line.statistics.waiting) == ([1], 0)


@on_line("tcp://10.0.0.1?max_in_flight=2")
async def test_a_client_that_disconnects_at_an_answer_gets_no_other_of_the_same_turn(
    plant: Plant,
) -> None:
    class Leaving(Asker):
        def take_response(self, forwarded: ForwardedRequest, response: bytes | None) -> None:
            super().take_response(forwarded, response)
            for other in waiting:
                if other is not forwarded:
                    plant.line.leave(other)

    note_done, done = plant.line._note_done, list[ForwardedRequest]()

    def note_both(each: ForwardedRequest) -> None:
        done.append(each)
        for one in done if len(done) == 2 else ():
            note_done(one)

    plant.line._note_done = note_both  # type: ignore[method-assign]
    asker = Leaving()
    waiting = [plant.ask(1, asker), plant.ask(2, asker)]
    await asyncio.sleep(1)
    assert (len(asker.answers), len(plant.line.in_flight)) == (1, 0)


def test_the_queue_of_all_clients_together_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gateway_line, "MOST_WAITING", 3)
    plant = Plant()

    async def main() -> None:
        askers = [Asker(f"192.0.2.{host}") for host in range(6)]
        for asker in askers:
            plant.ask(1, asker)
        assert [asker.answers for asker in askers[4:]] == [[f"code {BUSY}"]] * 2

    plant.run(main)


@each_case(
    ("requests", "is_kept"), [([READ], True), ([READ, WRITE], False), ([WRITE, READ], False)]
)
@on_line("tcp://10.0.0.1?max_in_flight=2")
async def test_no_answer_is_cached_that_may_be_older_than_a_write(plant: Plant, requests, is_kept):
    """Both may be in flight together: it is unknown which one the device executes first."""
    for request in requests:
        plant.ask(2, Asker(), request, age=1)
    await asyncio.sleep(0.5)
    assert plant.asked == [2] * len(requests)
    assert plant.has_cached(2) is is_kept


@on_line()
async def test_a_write_whose_client_disconnects_clears_the_cache_of_its_unit(
    plant: Plant,
) -> None:
    plant.ask(1, Asker(), age=60)
    await asyncio.sleep(1)
    assert plant.has_cached(1)
    write = plant.ask(1, Asker(), WRITE)
    await asyncio.sleep(0.01)
    plant.line.leave(write)
    assert plant.asked == [1, 1]
    assert not plant.has_cached(1)
    await asyncio.sleep(1)
    assert not plant.has_cached(1)


def test_the_cache_returns_answers_to_the_same_unit_and_request_up_to_their_age() -> None:
    cache = Cache()
    cache.keep(1, b"ask", b"answer", 10.0)
    for unit, request, now, answer in (
        *((1, b"ask", 10.5, b"answer"), (1, b"ask", 10.6, None)),
        *((2, b"ask", 10.0, None), (1, b"other", 10.0, None)),
    ):
        assert cache.get(unit, request, 0.5, now) == answer


@each_case(
    ("leaving", "moment", "units", "unwanted"),
    [
        ("a", "waiting", [1, 2], 1),
        ("bc", "waiting", [1, 2], 2),
        ("abc", "waiting", [1], 0),
        ("a", "sent", [1, 2], 1),
        ("abc", "sent", [1, 2], 3),
        ("ab", "answered", [1, 2], 2),
        ("abc", "answered", [1, 2], 3),
    ],
)
@on_line()
async def test_a_client_that_disconnects_does_not_affect_answers_to_others(
    plant: Plant, leaving: str, moment: str, units: list[int], unwanted: int
) -> None:
    plant.ask(1, Asker())
    askers = {name: Asker() for name in "abc"}
    waiting = {name: plant.ask(2, asker, merge=True) for name, asker in askers.items()}

    def leave() -> None:
        for name in leaving:
            plant.line.leave(waiting[name])

    note_done = plant.line._note_done

    def in_the_turn_of_the_answer(each: ForwardedRequest) -> None:
        note_done(each)
        if each.unit == 2:
            leave()

    if moment == "answered":
        plant.line._note_done = in_the_turn_of_the_answer  # type: ignore[method-assign]
    if moment == "sent":
        await asyncio.sleep(plant.delay * 1.5)
    if moment != "answered":
        leave()
    await asyncio.sleep(1)
    assert plant.asked == units
    assert plant.line.statistics.unwanted == unwanted
    for name, asker in askers.items():
        assert asker.answers == ([] if name in leaving else [answer_of(2, 2)])
    # Nothing holds requests together that are over.
    assert [entry.requester for entry in waiting.values()] == [None] * 3
    assert units == [1] or [entry.first for entry in waiting.values()] == [None] * 3
    # A read that no client waits for any more cannot be joined.
    later = Asker()
    plant.ask(2, later, merge=True)
    await asyncio.sleep(1)
    assert later.answers == [answer_of(2, len(units) + 1)]


@each_case(
    ("unit", "request", "is_joined"),
    [(2, WRITE, False), (0, WRITE, False), (3, WRITE, True), (2, INPUTS, True)],
)
@on_line()
async def test_a_read_is_not_answered_from_before_a_write(
    plant: Plant, unit: int, request: str, is_joined: bool
) -> None:
    plant.ask(1, Asker())
    first, second, alone = Asker(), Asker(), Asker()
    plant.ask(2, alone)  # reads of another route of the line are not joined
    plant.ask(2, first, merge=True, age=60)
    plant.ask(unit, Asker(), request)
    plant.ask(2, second, merge=True, age=60)
    await asyncio.sleep(2)
    assert alone.answers == [answer_of(2, 2)]
    assert first.answers == [answer_of(2, 3)]
    assert second.answers == [answer_of(2, 3 if is_joined else 5)]
    assert plant.unit(2).merged == is_joined


@on_line("rtu:///dev/line?timeout=9", longest_wait=2.0)
async def test_a_client_that_joined_a_read_late_is_not_refused_when_the_first_one_times_out(
    plant: Plant,
) -> None:
    plant.delays[1] = 3.0
    plant.ask(1, Asker())
    first, second, alone = Asker(), Asker(), Asker()
    plant.ask(2, first, merge=True)
    plant.ask(3, alone, merge=True)
    await asyncio.sleep(2)
    plant.ask(2, second, merge=True)
    await asyncio.sleep(2)
    assert alone.answers == [f"83{BUSY:02x}"]
    assert first.answers == second.answers == [answer_of(2, 2)]


@on_line("tcp://10.0.0.1")
async def test_a_missing_device_is_logged_once_and_again_at_its_return(
    plant: Plant, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(100, 1000))
    monkeypatch.setattr("time.time", lambda: float(next(clock)))
    caplog.set_level(logging.WARNING, logger=TOLD)
    asker = Asker()
    changes: list[tuple[bool, float]] = []
    for is_there in (True, False, False, True, True):
        if is_there:
            plant.network.listen(plant.peer.url, plant.peer._accept)
        else:
            plant.network.unlisten(plant.peer.url)
            plant.peer.drop_all()
        plant.ask(1, asker)
        await asyncio.sleep(5)
        changes.append((bool(plant.line.statistics.trouble), plant.line.statistics.since))
    open_first, down, still_down, open_again, still_open = changes
    assert [is_down for is_down, _ in changes] == [False, True, True, False, False]
    assert 0 < open_first[1] < down[1] < open_again[1]
    assert (still_down, still_open) == (down, open_again)
    assert [answer == REFUSED for answer in asker.answers] == [False, True, True, False, False]
    assert (plant.unit(1).lost, plant.unit(1).is_silent) == (2, False)
    assert len(caplog.messages) == 2
    assert caplog.messages[0].endswith("; trying again")
    assert logged(caplog)[1] == "open again"


@on_line("tcp://10.0.0.1")
async def test_a_line_that_fails_with_each_request_is_opened_every_two_seconds(plant: Plant):
    """The pause that doubles each time, a fifth shorter at random, is no longer than that."""
    plant.peer.on_request = lambda request, write: plant.peer.drop_all()
    asker = Asker()
    for _ in range(200):
        plant.ask(1, asker)
        await asyncio.sleep(0.5)
    assert set(asker.answers) == {REFUSED}
    assert 100 / 2 <= plant.peer.connections <= 100 / 1.6 + 6


def test_the_oldest_cached_answer_is_dropped_beyond_the_limit() -> None:
    cache = Cache()
    for number in range(MOST_CACHED):
        cache.keep(1, bytes([3, *divmod(number, 256)]), b"old", 1.0)
    first, second = b"\3\0\0", b"\3\0\1"
    assert cache.get(1, first, 9.0, 1.0) == b"old"
    cache.keep(1, first, b"new", 2.0)
    cache.keep(1, b"one more", b"new", 2.0)
    assert cache.get(1, first, 9.0, 2.0) == b"new"
    assert cache.get(1, second, 9.0, 2.0) is None
    assert cache.get(1, b"\3\0\2", 9.0, 2.0) == b"old"
