"""Who may ask next on a connection that many share, with a client that is a list."""

from libmodbus_py.pdu import ReadCoils
from libmodbus_py.services.line import FairQueue, LineRequest, pause_after
from tests.support.cases import each_case

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
    names = []
    while (each := queue.pick(any_of)) is not None:
        names.append(f"{each.client}{each.unit}")
    return " ".join(names)


@each_case(
    ("queue_text", "turns"),
    [
        ("a0 a1 a2 a3 b0 c0 b1", "a0 b0 c0 a1 b1 a2 a3"),  # clients take turns
        ("a0 b0 c0 d0 x0 x1", "a0 x0 b0 x1 c0 d0"),  # and hosts do
        ("a0 a1 a2", "a0 a1 a2"),
    ],
)
def test_hosts_and_their_clients_take_turns(queue_text: str, turns: str) -> None:
    queue: FairQueue[LineRequest] = FairQueue()
    entries = requests(queue_text)
    assert all(map(queue.put, entries))
    assert queue.count == len(list(queue)) == len(entries)
    assert order(queue) == turns
    assert (queue.count, list(queue), queue.pick(any_of)) == (0, [], None)


def test_one_client_fills_only_its_own_queue_and_the_total_is_limited() -> None:
    queue: FairQueue[LineRequest] = FairQueue(2, 3)
    a0, a1, a2, b0, x0 = requests("a0 a1 a2 b0 x0")
    assert [queue.put(entry) for entry in (a0, a1, a2, b0, x0)] == [True, True, False, True, False]
    assert queue.remove(a1)
    assert not queue.remove(a1)
    assert [queue.put(entry) for entry in (a2, x0)] == [True, False]
    assert order(queue) == "a0 b0 a2"


@each_case(
    ("misses", "first", "pause"),
    [
        *((1, 1.0, 1.0), (2, 1.0, 2.0), (4, 1.0, 8.0), (9, 1.0, 60.0)),
        *((10**9, 1.0, 60.0), (1, 300.0, 300.0), (5, 300.0, 300.0)),
    ],
)
def test_pauses_double_up_to_the_longest(misses: int, first: float, pause: float) -> None:
    assert pause_after(misses, first, 60.0) == pause
