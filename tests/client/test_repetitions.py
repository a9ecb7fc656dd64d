"""
Requests that are sent again, in bytes and times: when, and what becomes of those beside them.
"""

from __future__ import annotations

from libmodbus_py import FrameError, ModbusConnectionError, ModbusError, ModbusTimeoutError, pdu
from tests.client.test_window import grown
from tests.support.cases import each_case
from tests.support.talk import LINE, TCP, Talk, kinds, rtu, tcp, value


def test_all_that_are_due_leave_together() -> None:
    talk = Talk(busy_retries=1)
    batches = [talk.ask(number) for number in range(3)]
    talk.come(*[tcp(each, "83 06") for each in talk.sent])
    talk.now = 0.1
    talk.connection.tick(talk.now)
    assert len(talk.connection.start(talk.now)) == 3
    assert not any(batch.is_done for batch in batches)


def test_they_are_spaced_as_all_requests_are() -> None:
    talk = Talk(busy_retries=1, request_spacing=0.25)
    for number in range(3):
        talk.ask(number)
    talk.wait(0.5)
    talk.come(*[tcp(each, "83 06") for each in talk.sent])
    talk.wait(2)
    assert [round(at, 3) for at in talk.times] == [0, 0.25, 0.5, 0.75, 1.0, 1.25]


def test_one_that_cannot_be_sent_again_leaves_the_line_to_the_next_of_its_batch() -> None:
    talk = Talk(LINE, timeout=1, retries=1)
    batch = talk.ask(1, 2, go_on=True)
    talk.wait(1)
    while kinds(batch)[0] is not FrameError:
        talk.come(b"\xff")
        talk.wait(0.25)
        assert talk.now < 9
    talk.wait_for(2)
    talk.come(value(2))
    talk.wait(1)  # held, because the answer to the first one may still come
    assert kinds(batch) == [FrameError, [2]]
    assert talk.is_at_rest


def test_what_was_lost_beside_others_is_counted_as_sent_again() -> None:
    talk = grown()
    sent = len(talk.sent)
    batches = [talk.ask(1), talk.ask(2), talk.ask(3)]
    assert len(talk.sent) == sent + 3
    talk.wait(0.25)  # the first of them is asked alone
    assert (len(talk.sent), talk.statistics.retries) == (sent + 4, 1)
    while not talk.is_at_rest:
        talk.come(tcp(talk.sent[-1]))
    assert [each.outcomes for each in batches] == [[[1]], [[2]], [[3]]]
    assert (len(talk.sent), talk.statistics.retries) == (sent + 6, 3)
    assert talk.statistics.timeouts == 0


def test_what_nobody_answers_alone_either_is_not_sent_again() -> None:
    talk = grown(timeouts_before_reconnect=99)
    sent, limit = len(talk.sent), talk.connection.room
    batch = talk.ask(*range(limit + 3), limit=16, go_on=True)
    assert len(talk.sent) == sent + limit
    talk.wait(9)
    assert kinds(batch) == [ModbusTimeoutError] * (limit + 3)
    # Each of them once, and one of them alone.
    assert len(talk.sent) == sent + limit + 3 + 1
    assert talk.statistics.retries == 1


def answered(talk: Talk, at: int = -1) -> None:
    """Confirm a write, or answer a read of one register with its address."""
    adu = talk.sent[at]
    if talk.has_ids:
        talk.come(tcp(adu, adu[7:].hex()) if adu[7] == 6 else tcp(adu))
    else:
        talk.come(adu if adu[1] == 6 else value(int.from_bytes(adu[2:4], "big")))


def refused(talk: Talk, body: str) -> None:
    talk.come(tcp(talk.sent[-1], body) if talk.has_ids else rtu("01 " + body))


def values(talk: Talk) -> list[int]:
    """Return what the writes that were sent write."""
    at = 7 if talk.has_ids else 1
    return [int.from_bytes(adu[at + 3 : at + 5], "big") for adu in talk.sent if adu[at] == 6]


@each_case(("url", "trouble"), [
    (url, trouble)
    for url in (TCP, "rtu+tcp://192.0.2.1")
    for trouble in ("busy", "silence", "loss")
])  # fmt: skip
def test_an_older_write_is_never_sent_after_a_newer_one(url: str, trouble: str) -> None:
    """Two tasks with one client: the newer write waits until the older one is over."""
    talk = Talk(url, max_in_flight=None, timeout=1, retries=1, busy_retries=1, max_pause=0)
    older = talk.ask(pdu.WriteRegister(1, 1))
    newer = talk.ask(pdu.WriteRegister(1, 2))
    assert values(talk) == [1]
    if trouble == "busy":
        refused(talk, "86 06")
    elif trouble == "silence":
        talk.wait(1)
    else:
        talk.lose()
        talk.open()
    talk.wait_for(2)
    assert values(talk) == [1, 1]
    answered(talk)
    talk.wait_for(3)  # on a line the answer may be held
    answered(talk)
    talk.wait(0.5)
    assert (older.outcomes, newer.outcomes) == ([None], [None])
    assert values(talk) == [1, 1, 2]


@each_case("trouble", ["busy", "silence", "loss"])
def test_with_a_given_number_an_older_write_fails_once_a_newer_one_was_sent(trouble: str) -> None:
    talk = Talk(max_in_flight=2, timeout=1, retries=1, busy_retries=1, max_pause=0)
    older = talk.ask(pdu.WriteRegister(1, 1))
    newer = talk.ask(pdu.WriteRegister(1, 2))
    assert values(talk) == [1, 2]
    answered(talk)
    assert newer.outcomes == [None]
    if trouble == "busy":
        talk.come(tcp(talk.sent[0], "86 06"))
    elif trouble == "silence":
        talk.wait(1)
    else:
        talk.lose()
        talk.open()
    talk.wait(5)
    assert isinstance(older.outcomes[0], ModbusError)
    assert values(talk) == [1, 2]


def test_what_waits_behind_a_repetition_fails_with_it_when_no_connection_is_made() -> None:
    for url in (LINE, TCP):
        talk = Talk(url, timeout=1, retries=3)
        batch = talk.ask(1, 2, 3, go_on=True)
        talk.wait(1.5)
        talk.lose()
        talk.fail()
        assert kinds(batch) == [ModbusConnectionError] * 3
        assert batch.is_done


def test_a_repetition_is_not_sent_once_its_caller_has_left() -> None:
    for url, busy in ((LINE, rtu("01 83 06")), (TCP, None)):
        talk = Talk(url, timeout=1, busy_retries=3)
        batch = talk.ask(1)
        talk.come(busy or tcp(talk.sent[0], "83 06"))
        assert not batch.is_done
        talk.cancel(batch)
        talk.wait(10)
        assert len(talk.sent) == 1
        assert talk.is_at_rest
