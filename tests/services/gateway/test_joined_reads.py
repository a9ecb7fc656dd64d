"""
Equal reads that wait in a gateway are sent once, and all who asked are answered.
"""

from __future__ import annotations

import asyncio

from libmodbus_py.services.gateway.line import BUSY, NO_ANSWER, Forwarded
from tests.services.gateway.test_line import WRITE, Asker, Plant, answer_of
from tests.support.cases import each_case


@each_case(
    ("leaving", "moment", "asked", "unwanted"),
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
def test_who_leaves_takes_only_his_own_answer_with_him(
    leaving: str, moment: str, asked: list[int], unwanted: int
) -> None:
    plant = Plant()

    async def main() -> None:
        plant.ask(1, Asker())
        askers = {name: Asker() for name in "abc"}
        waiting = {name: plant.ask(2, asker, merge=True) for name, asker in askers.items()}

        def leave() -> None:
            for name in leaving:
                plant.line.leave(waiting[name])

        note_done = plant.line._note_done

        def in_the_turn_of_the_answer(each: Forwarded) -> None:
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
        assert plant.asked == asked
        assert plant.line.statistics.unwanted == unwanted
        for name, asker in askers.items():
            assert asker.answers == ([] if name in leaving else [answer_of(2, 2)])
        # Nothing holds requests together that are over.
        assert [each.asker for each in waiting.values()] == [None] * 3
        assert asked == [1] or [each.first for each in waiting.values()] == [None] * 3
        # A read that no client waits for any more cannot be joined.
        later = Asker()
        plant.ask(2, later, merge=True)
        await asyncio.sleep(1)
        assert later.answers == [answer_of(2, len(asked) + 1)]

    plant.run(main)


@each_case(
    ("unit", "request", "is_joined"),
    [(2, WRITE, False), (0, WRITE, False), (3, WRITE, True), (2, "04 0000 0001", True)],
)
def test_a_read_is_not_answered_with_what_was_read_before_a_write(
    unit: int, request: str, is_joined: bool
) -> None:
    plant = Plant()

    async def main() -> None:
        plant.ask(1, Asker())
        first, second = Asker(), Asker()
        plant.ask(2, first, merge=True, age=60)
        plant.ask(unit, Asker(), request)
        plant.ask(2, second, merge=True, age=60)
        await asyncio.sleep(2)
        assert first.answers == [answer_of(2, 2)]
        assert second.answers == [answer_of(2, 2 if is_joined else 4)]
        assert plant.unit(2).merged == is_joined

    plant.run(main)


def test_who_joined_late_is_not_refused_because_the_first_waited_for_too_long() -> None:
    plant = Plant("rtu:///dev/line?timeout=9", longest_wait=2.0)

    async def main() -> None:
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

    plant.run(main)


def test_those_who_wait_are_answered_over_the_next_connection_with_one_request() -> None:
    plant = Plant("tcp://10.0.0.1")
    plant.url = f"{plant.peer.url}?timeout=5&max_in_flight=1"

    async def main() -> None:
        plant.silent.add(1)
        lost, askers = Asker(), [Asker() for _ in range(3)]
        plant.ask(1, lost)
        for asker in askers:
            plant.ask(2, asker, merge=True)
        await asyncio.sleep(0.5)
        plant.peer.drop_all()
        await asyncio.sleep(2)
        assert lost.answers == [f"83{NO_ANSWER:02x}"]
        assert [asker.answers for asker in askers] == [[answer_of(2, 2)]] * 3
        assert plant.asked == [1, 2]

    plant.run(main)
