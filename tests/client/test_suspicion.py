"""
Answers that may be those to earlier requests: on a line without ids, times and contents tell.
"""

from __future__ import annotations

from libmodbus_py.client.suspicion import Suspicion

A, B, C = (bytes([3, 0, at, 0, 1]) for at in range(3))


def answer(value: int, count: int = 1) -> bytes:
    return bytes([3, 2 * count]) + value.to_bytes(2, "big") * count


def learnt(*took: float) -> Suspicion:
    """Return what knows one request whose answers took so long; each has another value."""
    suspicion = Suspicion()
    for at, each in enumerate(took):
        assert suspicion.accepts(1, A, answer(at), each)
    return suspicion


class TestTimes:
    def test_an_answer_in_less_than_half_of_the_shortest_time_is_doubtful(self) -> None:
        for took, expected in ((0.049, False), (0.05, True), (0.2, True)):
            assert learnt(0.1, 0.3).accepts(1, A, answer(99), took) is expected

    def test_the_shortest_time_is_one_of_its_kind(self) -> None:
        suspicion = learnt(0.1)
        assert not suspicion.accepts(1, B, answer(98), 0.01)
        assert suspicion.accepts(1, B, answer(98, count=2), 0.01)
        assert suspicion.accepts(2, A, answer(98), 0.01)

    def test_a_doubtful_answer_teaches_nothing(self) -> None:
        suspicion = learnt(0.1)
        for _ in range(3):
            assert not suspicion.accepts(1, A, answer(99), 0.04)
        assert suspicion.accepts(1, A, answer(99), 0.06)

    def test_answers_may_become_slower_and_vary(self) -> None:
        suspicion = learnt(*[0.1] * 50)
        for at in range(50):
            assert suspicion.accepts(1, A, answer(100 + at), 0.5 if at % 2 else 0.1)

    def test_answers_that_all_come_sooner_than_usual_are_doubtful_after_some(self) -> None:
        suspicion = learnt(*[0.1] * 200)
        found = [suspicion.accepts(1, A, answer(200 + at % 2), 0.06) for at in range(30)]
        first = found.index(False)
        assert 4 <= first <= 16
        assert not any(found[first:])

    def test_what_was_doubtful_and_true_is_believed_from_then_on(self) -> None:
        suspicion = learnt(*[0.1] * 200)
        while suspicion.accepts(1, A, answer(200), 0.06):
            pass
        suspicion.clear(1, A, answer(200), 0.06)
        assert all(suspicion.accepts(1, A, answer(201 + at % 2), 0.06) for at in range(30))
        suspicion.clear(1, A, answer(210), 0.01)
        assert suspicion.accepts(1, A, answer(211), 0.01)

    def test_the_shortest_time_falls_with_each_that_is_shorter(self) -> None:
        assert learnt(0.1, 0.06).accepts(1, A, answer(99), 0.04)
        assert not learnt(0.1, 0.06).accepts(1, A, answer(99), 0.029)

    def test_times_of_several_kinds_are_known_beside_each_other(self) -> None:
        suspicion = learnt(0.1)
        assert suspicion.accepts(1, B, answer(98, count=2), 0.5)
        assert not suspicion.accepts(1, A, answer(97), 0.01)
        assert not suspicion.accepts(1, B, answer(96, count=2), 0.01)

    def test_a_true_answer_is_remembered_though_the_last_ones_were_faster(self) -> None:
        suspicion = learnt(*[0.1] * 200)
        while suspicion.accepts(1, A, answer(200), 0.06):
            pass
        suspicion.clear(1, A, answer(999), 0.06)
        assert suspicion.repeats(1, B, answer(999))

    def test_an_answer_that_was_doubted_for_its_value_leaves_the_usual_time(self) -> None:
        suspicion = learnt(*[0.1] * 300)
        suspicion.clear(1, B, answer(299), 0.2)
        assert suspicion.patience(1, A, answer(1)) < 0.15

    def test_a_time_that_was_believed_once_is_the_shortest(self) -> None:
        suspicion = learnt(0.1)
        suspicion.clear(1, A, answer(9), 0.02)
        assert suspicion.accepts(1, A, answer(8), 0.01)
        assert not suspicion.accepts(1, A, answer(7), 0.004)


class TestRepeats:
    def test_the_answer_to_another_request_is_doubtful(self) -> None:
        suspicion = Suspicion()
        assert suspicion.accepts(1, A, answer(7), 0.1)
        assert not suspicion.accepts(1, B, answer(7), 0.1)
        assert suspicion.repeats(1, B, answer(7))
        assert suspicion.accepts(1, B, answer(8), 0.1)

    def test_an_answer_again_to_the_same_request_is_not(self) -> None:
        suspicion = Suspicion()
        for _ in range(3):
            assert suspicion.accepts(1, A, answer(7), 0.1)
            assert not suspicion.repeats(1, A, answer(7))
        assert suspicion.accepts(1, A, answer(8), 0.1)
        assert suspicion.accepts(1, A, answer(7), 0.1)

    def test_that_of_another_unit_is_not(self) -> None:
        suspicion = Suspicion()
        assert suspicion.accepts(1, A, answer(7), 0.1)
        assert suspicion.accepts(2, B, answer(7), 0.1)

    def test_what_was_its_own_last_answer_is_not(self) -> None:
        suspicion = Suspicion()
        assert suspicion.accepts(1, A, answer(7), 0.1)
        suspicion.clear(1, B, answer(7), 0.1)
        assert suspicion.accepts(1, A, answer(7), 0.1)
        assert suspicion.accepts(1, B, answer(7), 0.1)

    def test_what_two_requests_have_in_common_is_not(self) -> None:
        suspicion = Suspicion()
        assert suspicion.accepts(1, A, answer(0), 0.1)
        assert not suspicion.accepts(1, B, answer(0), 0.1)
        suspicion.clear(1, B, answer(0), 0.1)
        assert suspicion.accepts(1, C, answer(0), 0.1)
        assert suspicion.accepts(2, A, answer(0), 0.1)

    def test_values_that_requests_have_in_common_add_up(self) -> None:
        suspicion = learnt(0.1, 0.1)  # 0 and 1
        for each in (0, 1):
            suspicion.clear(1, B, answer(each), 0.1)
        assert not suspicion.repeats(1, C, answer(0))
        assert not suspicion.repeats(1, C, answer(1))

    def test_the_last_sixteen_answers_come_again_or_those_of_50_ms(self) -> None:
        for count, took, expected in (
            *((15, 0.1, False), (16, 0.1, True)),
            *((49, 0.001, False), (51, 0.001, True), (99, 0.0005, False), (101, 0.0005, True)),
        ):
            suspicion = Suspicion()
            for at in range(20):
                assert suspicion.accepts(2, A, answer(at), 0.1)
            assert suspicion.accepts(1, A, answer(7), took)
            for at in range(count):
                assert suspicion.accepts(1, C, answer(100 + at), took)
            assert suspicion.accepts(1, B, answer(7), took) is expected, (count, took)

    def test_memory_is_bounded(self) -> None:
        suspicion = Suspicion()
        for at in range(5000):
            request = bytes([3, at >> 8, at & 0xFF, 0, 1])
            pdu = bytes([3, 2, at >> 8, at & 0xFF])
            assert suspicion.accepts(1, request, pdu, 0.1)
            suspicion.clear(1, A, pdu, 0.1)
            other = bytes([3, 2 + (at >> 8), *pdu, *bytes(at >> 8)])
            assert suspicion.accepts(2 + at % 250, request, other, 0.1)
        kept = (suspicion._answers, suspicion._times, suspicion._common)
        assert [len(each) <= 1024 for each in kept] == [True] * 3
        assert len(suspicion._common) <= 64
        assert len(suspicion._counts) <= 16

    def test_memory_is_bounded_of_a_unit_that_takes_no_time(self) -> None:
        suspicion = Suspicion()
        for at in range(3000):
            assert suspicion.accepts(1, A, answer(at), 0.0)
            assert suspicion.accepts(1, A, answer(0), 0.0)
        assert len(suspicion._counts) <= 1024


class TestPatience:
    def test_of_an_unknown_unit_it_is_the_least(self) -> None:
        assert Suspicion().patience(1, A, answer(1)) == 0.001
        assert learnt(0.1).patience(2, A, answer(1)) == 0.001

    def test_after_one_answer_it_is_three_times_as_long(self) -> None:
        """As the first time-out of TCP (RFC 6298, 2.2): the time, and four times half of it."""
        assert round(learnt(0.1).patience(1, A, answer(1)), 9) == 0.3

    def test_it_is_longer_than_the_usual_time_and_than_deviations(self) -> None:
        steady, varied = learnt(*[0.1] * 300), learnt(*[0.05, 0.15] * 150)
        assert 0.12 <= steady.patience(1, A, answer(1)) <= 0.13
        assert 0.2 <= varied.patience(1, A, answer(1)) <= 0.4

    def test_it_is_that_of_the_slower_kind_of_answer(self) -> None:
        suspicion = learnt(*[0.1] * 300)
        slow = b"\x83\x06"
        for _ in range(300):
            assert suspicion.accepts(1, B, slow, 1.0)
        assert suspicion.patience(1, A, slow) > 1.2
        assert suspicion.patience(1, A, answer(1)) < 0.2
        # Of a request without an answer so far, any kind of the unit counts.
        assert suspicion.patience(1, C, answer(1)) > 1.2
