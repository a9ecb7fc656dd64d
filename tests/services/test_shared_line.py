"""Who may ask next on a connection that many share, with a client that is a list."""

import asyncio
from collections.abc import Callable
from typing import Any, cast

from libmodbus_py import ModbusTimeoutError
from libmodbus_py.client.sender import Sender
from libmodbus_py.pdu import ReadCoils
from libmodbus_py.services.line import FairQueue, LineRequest, SharedLine, rest_after
from tests.simulation.given import simulated
from tests.support.cases import each_case
from tests.support.talk import little_kept

TIMEOUT = 1.0
READ = ReadCoils(0, 1)


def any_of(each: object) -> bool:
    return True


def requests(names: str) -> list[LineRequest]:
    """Return requests of clients, such as "a0 b0"; clients before "m" are of one host."""
    return [
        LineRequest(int(name[1]), READ, host=name[0] < "m", client=name[0])
        for name in names.split()
    ]


def order(queue: FairQueue[LineRequest]) -> str:
    found = []
    while (each := queue.pick(any_of)) is not None:
        found.append(f"{each.client}{each.unit}")
    return " ".join(found)


@each_case(
    ("given", "expected"),
    [
        ("a0 a1 a2 a3 b0 c0 b1", "a0 b0 c0 a1 b1 a2 a3"),  # clients take turns
        ("a0 b0 c0 d0 x0 x1", "a0 x0 b0 x1 c0 d0"),  # and hosts do
        ("a0 a1 a2", "a0 a1 a2"),
    ],
)
def test_hosts_and_their_clients_take_turns(given: str, expected: str) -> None:
    queue: FairQueue[LineRequest] = FairQueue()
    asked = requests(given)
    assert all(map(queue.put, asked))
    assert queue.count == len(list(queue)) == len(asked)
    assert order(queue) == expected
    assert (queue.count, list(queue), queue.pick(any_of)) == (0, [], None)


def test_one_client_fills_its_own_queue_only_and_all_have_a_bound() -> None:
    queue: FairQueue[LineRequest] = FairQueue(2, 3)
    a0, a1, a2, b0, x0 = requests("a0 a1 a2 b0 x0")
    assert [queue.put(each) for each in (a0, a1, a2, b0, x0)] == [True, True, False, True, False]
    assert queue.remove(a1)
    assert not queue.remove(a1)
    assert [queue.put(each) for each in (a2, x0)] == [True, False]
    assert order(queue) == "a0 b0 a2"


def test_an_executed_request_leaves_nothing_in_the_queues() -> None:
    queue: FairQueue[LineRequest] = FairQueue(9, 99)
    with little_kept():
        for at in range(2000):
            each, other = LineRequest(1, host=at, client=at), LineRequest(1, host=0, client=at)
            assert queue.put(each)
            assert queue.put(other)
            assert {queue.pick(any_of), queue.pick(any_of)} == {each, other}


@each_case(
    ("misses", "first", "rest"),
    [
        *((1, 1.0, 1.0), (2, 1.0, 2.0), (4, 1.0, 8.0), (9, 1.0, 60.0)),
        *((10**9, 1.0, 60.0), (1, 300.0, 300.0), (5, 300.0, 300.0)),
    ],
)
def test_rests_double_up_to_the_longest(misses: int, first: float, rest: float) -> None:
    assert rest_after(misses, first, 60.0) == rest


class Flight:
    """A request in flight."""

    is_sent = True
    is_answered = False

    def __init__(self, on_done: Callable[[], object]) -> None:
        self.outcome: Any = None
        self.on_done = on_done
        self.is_withdrawn = False

    def withdraw(self) -> None:
        self.is_withdrawn = True

    def send_no_more(self) -> bool:
        return not self.is_sent


class Client:
    """A client, and its sender, that sends nothing."""

    timeout = TIMEOUT

    def __init__(self, room: int, owing: dict[int, float] | None) -> None:
        self.room = room
        self.has_ids = owing is None
        self.owing = owing or {}
        self.client = self

    def submit(self, unit: int, request: object, on_done: Callable[[], object]) -> Flight:
        return Flight(on_done)

    def ready_at(self, unit: int, function: int) -> float:
        return self.owing.get(unit, 0.0)

    async def close(self) -> None:
        pass


class Line(SharedLine[LineRequest]):
    """
    A line, and what came of its requests.

    Attributes:
        log: the units that were asked; those whose trial made way, with a minus.
    """

    def __init__(
        self, room: int = 1, owing: dict[int, float] | None = None, **options: Any
    ) -> None:
        super().__init__(cast(Sender, Client(room, owing)), FairQueue, **options)
        self.log: list[int] = []
        self.over: list[tuple[int, Any]] = []

    def _send(self, each: LineRequest, now: float) -> None:
        self.log.append(each.unit)
        super()._send(each, now)

    def conclude(self, each: LineRequest, outcome: Any, now: float) -> None:
        if isinstance(outcome, ModbusTimeoutError):
            self.log.append(-each.unit)
        self.over.append((each.unit, outcome))

    def put(self, *units: int, is_trial: bool = False, misses: int = 1) -> list[LineRequest]:
        """Ask units; return the requests."""
        made = []
        for unit in units:
            each = LineRequest(unit, READ)
            each.is_trial, each.misses = is_trial, misses
            each.waits_since = self._loop.time()
            assert self.ask(each, each.waits_since)
            made.append(each)
        return made

    async def answer(self, each: LineRequest, outcome: Any = b"") -> None:
        flight = cast(Flight, each.submitted)
        flight.outcome = outcome
        flight.on_done()
        await asyncio.sleep(0)

    async def answer_after(self, seconds: float, unit: int) -> None:
        """Ask a unit, which answers after so many seconds."""
        (each,) = self.put(unit)
        await asyncio.sleep(seconds)
        await self.answer(each)


@simulated
async def test_one_request_is_sent_although_there_is_no_room_now() -> None:
    """Or a client that recovers from a failure would be asked nothing for ever."""
    line = Line(room=0)
    line.put(1, 2)
    assert line.log == [1]


@simulated
async def test_urgent_requests_come_first() -> None:
    line = Line()
    first, *_ = line.put(1, 2)
    urgent = LineRequest(3, READ)
    urgent.is_urgent = urgent.is_trial = True
    assert line.ask(urgent, 0.0)
    await line.answer(first)
    assert line.log == [1, 3]


@simulated
async def test_a_dropped_request_is_not_sent_and_a_withdrawn_one_has_no_outcome() -> None:
    line = Line()
    sent, waiting, other, last = line.put(1, 2, 3, 4)
    (trial,) = line.put(9, is_trial=True)
    assert not line.drop(sent)
    assert line.drop(waiting)
    assert not line.drop(waiting)
    assert line.drop(trial)
    await line.answer(sent)
    assert (line.log, line.over) == ([1, 3], [(1, b"")])
    cast(Flight, other.submitted).is_sent = False  # the client could not send it yet
    assert line.drop(other)
    await asyncio.sleep(0)
    assert (line.log, len(line.in_flight)) == ([1, 3, 4], 1)
    flight = cast(Flight, last.submitted)
    flight.on_done()
    line.withdraw(last)  # its answer has come in this turn of the loop
    assert not flight.is_withdrawn
    await asyncio.sleep(0)
    assert (line.over, len(line.in_flight)) == ([(1, b"")], 0)


@simulated
async def test_an_outcome_may_withdraw_requests_answered_in_the_same_turn() -> None:
    """A device may be removed because of what another one answered."""

    class Removing(Line):
        def conclude(self, each: LineRequest, outcome: Any, now: float) -> None:
            super().conclude(each, outcome, now)
            if each is first:
                self.withdraw(second)

    line = Removing(room=2)
    first, second, _ = line.put(1, 2, 3)
    for each in (first, second):
        flight = cast(Flight, each.submitted)
        flight.outcome = b""
        flight.on_done()
    await asyncio.sleep(0)
    assert (line.over, len(line.in_flight), line.log) == ([(1, b"")], 1, [1, 2, 3])


@each_case(("most", "expected"), [(9, 3), (2, 2), (1, 1)])
@simulated
async def test_as_many_trials_are_made_as_may_be(most: int, expected: int) -> None:
    line = Line(room=9, most_trials=most)
    trials = line.put(1, 2, 3, is_trial=True)
    assert line.log == [1, 2, 3][:expected]
    await line.answer(trials[0])
    assert line.log == [1, 2, 3][: expected + 1]


@simulated
async def test_a_unit_that_was_slower_has_as_long_as_its_own_answers_took() -> None:
    """All others are fast, and what was slow is long ago."""
    line = Line()
    await line.answer_after(0.4, 9)
    for _ in range(100):
        await line.answer_after(0.01, 1)
    line.log.clear()
    line.put(9, is_trial=True)
    line.put(1)
    await asyncio.sleep(0.39)
    assert line.log == [9]
    await asyncio.sleep(0.02)
    assert line.log == [9, -9, 1]


@simulated
async def test_a_trial_is_not_ended_for_a_request_that_has_room_or_an_answer() -> None:
    line = Line(room=2)
    (trial,) = line.put(9, is_trial=True)
    await asyncio.sleep(0.5)
    line.put(1)
    assert line.log == [9, 1]
    cast(Any, trial.submitted).is_answered = True  # it may still turn out to be another one's
    line.put(2)
    await asyncio.sleep(0.5)
    assert line.log == [9, 1]
    await line.answer(trial)
    assert line.log == [9, 1, 2]


@simulated
async def test_the_time_of_what_failed_is_not_that_of_an_answer() -> None:
    for outcome in (ModbusTimeoutError("silent"), None):
        line = Line()
        (each,) = line.put(1)
        await asyncio.sleep(0.5)
        await line.answer(each, outcome)
        line.log.clear()
        line.put(9, is_trial=True)
        line.put(1)
        await asyncio.sleep(0.1)
        assert line.log == [9, -9, 1]
