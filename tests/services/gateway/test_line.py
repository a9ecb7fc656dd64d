"""
A line of a gateway in simulated time: who is asked when, and who is told what.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Hashable
from typing import Any

import pytest

from libmodbus_py.ports.endpoint import parse
from libmodbus_py.services import line as shared_line
from libmodbus_py.services.gateway import line as gateway_line
from libmodbus_py.services.gateway.line import BUSY, NO_ANSWER, Forwarded, GatewayLine, request_of
from libmodbus_py.services.gateway.routes import GatewayOptions
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted, Write
from tests.support.talk import rtu

READ, WRITE = "03 0000 0001", "06 0000 0007"

TIMEOUT = 0.5


class Asker:
    """A client of the gateway, and what it was told."""

    def __init__(self, host: Hashable = "192.0.2.1") -> None:
        self.host = host
        self.answers: list[str | None] = []

    def answered(self, forwarded: Forwarded, response: bytes | None) -> None:
        self.answers.append(None if response is None else response.hex())


class Plant:
    """
    A line, and units on it that answer each request after a while, if at all.

    Attributes:
        asked: the units that were asked, in their order.
        silent: units that give no answer.
        delay: seconds that an answer takes.
        refusing: units that answer with exception 2.
        damaging: units whose answers have wrong check bytes.
    """

    def __init__(self, url: str = "rtu:///dev/line?timeout=0.5", **options: Any) -> None:
        self.network = Network()
        self.url = url
        self.options = options
        self.asked: list[int] = []
        self.silent: set[int] = set()
        self.refusing: set[int] = set()
        self.damaging: set[int] = set()
        self.delay = 0.05
        self.delays: dict[int, float] = {}
        self.line: GatewayLine
        peer = Scripted(self.network, url.partition("?")[0], self._answer)
        self.peer = peer

    def _answer(self, request: bytes, write: Write) -> None:
        has_ids = self.url.startswith("tcp")
        head, unit, body = request[:4], request[6 if has_ids else 0], request[1:-2]
        body = request[7:] if has_ids else body
        self.asked.append(unit)
        if unit in self.silent or not unit:
            return
        if unit in self.refusing:
            pdu = bytes([body[0] | 0x80, 2])
        elif body[0] in (3, 4):
            pdu = body[:1] + b"\x02" + bytes([unit, len(self.asked) & 0xFF])
        else:
            pdu = body
        answer = rtu(bytes([unit, *pdu]).hex())
        if unit in self.damaging:
            answer = answer[:-1] + bytes([answer[-1] ^ 1])
        if has_ids:
            answer = head + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu
        write(answer, self.delays.get(unit, self.delay))

    def run(self, main: Callable[[], Awaitable[None]]) -> None:
        async def whole() -> None:
            self.line = GatewayLine(parse(self.url), GatewayOptions(**self.options))
            try:
                await main()
            finally:
                await self.line.close()
            statistics = self.line.statistics
            assert (statistics.waiting, statistics.in_flight) == (0, 0)

        self.network.run(whole)

    def ask(
        self, unit: int, asker: Asker, request: str = READ, *, merge: bool = False, age: float = 0
    ) -> Forwarded:
        each = self.forwarded(unit, asker, request, age)
        code = self.line.put(each, merge=merge)
        if code:
            asker.answers.append(f"code {code}")
        return each

    def forwarded(self, unit: int, asker: Asker, request: str = READ, age: float = 0) -> Forwarded:
        given = request_of(bytes.fromhex(request))
        return Forwarded(asker, 1, unit, unit, given, self.network.events.now, age)

    @property
    def unit(self) -> Any:
        return self.line.statistics.unit


def answer_of(unit: int, number: int) -> str:
    return bytes([3, 2, unit, number]).hex()


class TestWhoIsGone:
    def test_who_is_gone_while_waiting_is_not_asked_for(self) -> None:
        plant = Plant()

        async def main() -> None:
            first, second, third = Asker(), Asker(), Asker()
            plant.ask(1, first)
            dropped = plant.ask(2, second)
            plant.ask(3, third)
            assert plant.line.statistics.waiting == 2
            plant.line.leave(dropped)
            assert plant.line.statistics.waiting == 1
            await asyncio.sleep(2)
            assert plant.asked == [1, 3]
            assert first.answers == [answer_of(1, 1)]
            assert second.answers == []
            assert third.answers == [answer_of(3, 2)]

        plant.run(main)

    def test_who_is_gone_after_it_was_sent_gets_nothing_and_is_counted(self) -> None:
        plant = Plant()

        async def main() -> None:
            asker = Asker()
            asked = plant.ask(1, asker)
            await asyncio.sleep(0.01)
            plant.line.leave(asked)
            await asyncio.sleep(1)
            assert plant.asked == [1]
            assert asker.answers == []
            assert plant.line.statistics.unwanted == 1
            assert plant.unit(1).answers == 1

        plant.run(main)

    def test_a_trial_that_nobody_wants_any_more_leaves_the_unit_due(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            plant.ask(1, Asker())
            trial = plant.ask(9, Asker())
            await asyncio.sleep(0.01)
            assert plant.asked == [9, 1]
            plant.line.leave(trial)
            plant.silent.clear()
            asker = Asker()
            plant.ask(9, asker)
            await asyncio.sleep(1)
            assert plant.asked == [9, 1, 9]
            assert asker.answers == [answer_of(9, 3)]

        plant.run(main)


class TestSilentUnits:
    def test_a_silent_unit_rests_and_is_tried_by_one_request(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        caplog.set_level(logging.INFO, logger="libmodbus_py.services.gateway")
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            first, second, third = Asker(), Asker(), Asker()
            plant.ask(9, first)
            plant.ask(9, second, "04 0000 0001")
            await asyncio.sleep(TIMEOUT + 0.1)
            # Who waits for the same unit is told at once.
            assert first.answers == [f"83{NO_ANSWER:02x}"]
            assert second.answers == [f"84{NO_ANSWER:02x}"]
            plant.ask(9, third)
            assert third.answers == [f"code {NO_ANSWER}"]
            assert (plant.unit(9).timeouts, plant.unit(9).resting) == (1, 2)
            assert plant.unit(9).is_silent
            plant.silent.clear()
            await asyncio.sleep(2 * TIMEOUT)
            plant.ask(9, first)
            plant.ask(9, second)
            assert second.answers[1:] == [f"code {NO_ANSWER}"]
            await asyncio.sleep(1)
            assert first.answers[1:] == [answer_of(9, 2)]
            assert not plant.unit(9).is_silent
            texts = [text.partition(": ")[2] for text in caplog.messages]
            assert texts == ["unit 9 does not answer", "unit 9 answers again"]

        plant.run(main)

    def test_a_trial_waits_for_others_but_not_for_ever(self) -> None:
        """On a line that never rests it has its turn after a timeout."""
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            plant.asked.clear()
            plant.silent.clear()

            def again() -> None:
                plant.ask(1, Busy())

            class Busy(Asker):
                def answered(self, forwarded: Forwarded, response: bytes | None) -> None:
                    if len(plant.asked) < 40:
                        again()

            again()
            again()
            tried = Asker()
            plant.ask(9, tried)
            await asyncio.sleep(10)
            place = plant.asked.index(9)
            assert 5 < place < 15
            assert tried.answers == [answer_of(9, place + 1)]

        plant.run(main)

    def test_a_trial_makes_way_when_another_waits(self) -> None:
        """It costs others what the slowest answer took, and its unit is held for a timeout."""
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            plant.ask(1, Asker())
            await asyncio.sleep(1)
            begun = plant.network.events.now
            tried, other = Asker(), Asker()
            plant.ask(9, tried)
            plant.ask(1, other)
            while not other.answers:
                await asyncio.sleep(0.01)
            assert plant.network.events.now - begun < TIMEOUT / 2
            assert tried.answers == [f"83{NO_ANSWER:02x}"]
            assert plant.unit(9).given_up == 1
            assert plant.unit(9).timeouts == 1

        plant.run(main)

    def test_a_trial_that_is_alone_waits_to_the_end(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            tried = Asker()
            plant.ask(9, tried)
            await asyncio.sleep(TIMEOUT - 0.1)
            assert tried.answers == []
            await asyncio.sleep(0.2)
            assert tried.answers == [f"83{NO_ANSWER:02x}"]
            assert plant.unit(9).given_up == 0
            # Twice as long as the first time.
            await asyncio.sleep(3 * TIMEOUT)
            plant.ask(9, tried)
            assert tried.answers[1:] == [f"code {NO_ANSWER}"]
            await asyncio.sleep(1.5 * TIMEOUT)
            plant.ask(9, tried)
            await asyncio.sleep(0.01)
            assert plant.asked == [9, 9, 9]

        plant.run(main)

    def test_one_trial_in_some_waits_to_the_end(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """The unit may have become slower than all others, and would never be found."""
        monkeypatch.setattr(shared_line, "TRIALS_BEFORE_LONG", 3)
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(TIMEOUT)
            plant.silent.clear()
            plant.delays[9] = 0.4 * TIMEOUT
            answered = 0
            for _ in range(4):
                await asyncio.sleep(40)
                plant.ask(1, Asker())
                await asyncio.sleep(1)
                tried, other = Asker(), Asker()
                plant.ask(9, tried)
                plant.ask(1, other)
                await asyncio.sleep(TIMEOUT + 2 * plant.delay)
                assert other.answers
                answered += tried.answers[0].startswith("03")
            assert answered == 2  # the third trial found it, and then it is like any other

        plant.run(main)

    def test_a_damaged_answer_holds_its_unit_for_a_timeout(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.damaging.add(5)
            bad, again, other = Asker(), Asker(), Asker()
            plant.ask(5, bad)
            await asyncio.sleep(0.2)
            assert bad.answers == [f"83{NO_ANSWER:02x}"]
            assert plant.unit(5).invalid == 1
            plant.damaging.clear()
            plant.ask(5, again)
            plant.ask(6, other)
            await asyncio.sleep(0.2)
            assert (again.answers, other.answers) == ([], [answer_of(6, 2)])
            await asyncio.sleep(0.1)
            assert again.answers == []
            await asyncio.sleep(0.2)
            assert plant.asked == [5, 6, 5]
            # It could be the damaged one that came again, and it is not known yet how long its
            # answers take.
            await asyncio.sleep(TIMEOUT)
            assert again.answers == [f"83{NO_ANSWER:02x}"]
            await asyncio.sleep(2 * TIMEOUT)
            plant.ask(5, again)
            await asyncio.sleep(0.2)
            assert again.answers[1:] == [answer_of(5, 4)]
            assert not plant.unit(5).is_silent

        plant.run(main)

    def test_a_trial_with_a_damaged_answer_is_followed_by_a_longer_rest(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            plant.silent.clear()
            plant.damaging.add(9)
            tried, early, late = Asker(), Asker(), Asker()
            plant.ask(9, tried)
            await asyncio.sleep(0.5)
            assert tried.answers == [f"83{NO_ANSWER:02x}"]
            plant.damaging.clear()
            await asyncio.sleep(3 * TIMEOUT)
            plant.ask(9, early)
            assert early.answers == [f"code {NO_ANSWER}"]
            await asyncio.sleep(2 * TIMEOUT)
            plant.ask(9, late)
            await asyncio.sleep(0.5)
            assert late.answers == [answer_of(9, 3)]

        plant.run(main)

    def test_a_trial_whose_connection_is_lost_is_followed_by_another(self) -> None:
        plant = Plant("tcp://10.0.0.1")
        plant.url = plant.peer.url + "?timeout=0.5"

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            lost, late = Asker(), Asker()
            plant.ask(9, lost)
            await asyncio.sleep(0.1)
            plant.peer.drop_all()
            await asyncio.sleep(0.1)
            assert lost.answers == [f"83{NO_ANSWER:02x}"]
            plant.silent.clear()
            await asyncio.sleep(5 * TIMEOUT)
            plant.ask(9, late)
            await asyncio.sleep(1)
            assert late.answers == [answer_of(9, 3)]

        plant.run(main)


class TestTurns:
    def test_a_client_that_leaves_when_it_is_told_so_takes_its_other_requests_with_it(
        self,
    ) -> None:
        plant = Plant(longest_wait=0.01)

        class Leaving(Asker):
            def answered(self, forwarded: Forwarded, response: bytes | None) -> None:
                super().answered(forwarded, response)
                plant.line.leave(joined.pop())

        asker = Leaving()
        joined: list[Forwarded] = []

        async def main() -> None:
            plant.ask(1, Asker())
            plant.ask(2, asker, merge=True)
            joined.append(plant.ask(2, asker, merge=True))
            await asyncio.sleep(1)
            assert asker.answers == [f"83{BUSY:02x}"]
            assert (plant.asked, plant.line.statistics.waiting) == ([1], 0)

        plant.run(main)

    def test_all_clients_together_have_a_bound(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(gateway_line, "MOST_WAITING", 3)
        plant = Plant()

        async def main() -> None:
            askers = [Asker(f"192.0.2.{host}") for host in range(6)]
            for asker in askers:
                plant.ask(1, asker)
            assert [each.answers for each in askers[4:]] == [[f"code {BUSY}"]] * 2

        plant.run(main)

    def test_over_tcp_several_are_asked_at_once(self) -> None:
        plant = Plant("tcp://10.0.0.1?max_in_flight=3")

        async def main() -> None:
            plant.delay = 0.3
            for unit in range(1, 6):
                plant.ask(unit, Asker())
            await asyncio.sleep(0.1)
            assert plant.asked == [1, 2, 3]
            assert plant.line.statistics.in_flight == 3
            assert plant.line.statistics.waiting == 2
            await asyncio.sleep(1)
            assert plant.asked == [1, 2, 3, 4, 5]

        plant.url = plant.peer.url + "?max_in_flight=3"
        plant.run(main)


class TestAnswers:
    def test_a_read_joins_one_that_waits_but_none_that_was_sent(self) -> None:
        plant = Plant()

        async def main() -> None:
            askers = [Asker() for _ in range(4)]
            plant.ask(2, askers[0], merge=True)
            plant.ask(2, askers[1], merge=True)
            plant.ask(2, askers[2], merge=True)
            plant.ask(2, askers[3])
            await asyncio.sleep(1)
            assert plant.asked == [2, 2, 2]
            assert askers[1].answers == askers[2].answers == [answer_of(2, 2)]
            assert askers[3].answers == [answer_of(2, 3)]

        plant.run(main)

    def test_a_read_that_is_to_join_none_is_joined_by_none(self) -> None:
        """Routes of one line differ in that."""
        plant = Plant()

        async def main() -> None:
            alone, other = Asker(), Asker()
            plant.ask(1, Asker())
            plant.ask(2, alone)
            plant.ask(2, other, merge=True)
            await asyncio.sleep(1)
            assert (alone.answers, other.answers) == ([answer_of(2, 2)], [answer_of(2, 3)])

        plant.run(main)

    def test_an_answer_is_kept_for_whoever_takes_it_so_old(self) -> None:
        plant = Plant()

        async def main() -> None:
            request = request_of(bytes.fromhex(READ))
            begun = plant.network.events.now
            plant.ask(2, Asker(), age=1)
            await asyncio.sleep(0.5)
            now = plant.network.events.now
            kept = plant.line.cached(2, request, 1, now)
            assert kept is not None
            assert kept.hex() == answer_of(2, 1)
            assert plant.unit(2).cached == 1
            # It is as old as its request.
            assert plant.line.cached(2, request, 1, begun + 1.01) is None
            assert plant.unit(2).cached == 1
            plant.ask(2, Asker(), WRITE)
            assert plant.line.cached(2, request, 1, now) is None

        plant.run(main)

    def test_what_nobody_wants_old_is_not_kept(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.ask(2, Asker())
            await asyncio.sleep(0.5)
            request = request_of(bytes.fromhex(READ))
            assert plant.line.cached(2, request, 9, plant.network.events.now) is None

        plant.run(main)

    def test_an_answer_to_a_read_before_a_write_is_not_kept(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.ask(2, Asker(), age=1)
            plant.ask(2, Asker(), WRITE)
            await asyncio.sleep(0.5)
            request = request_of(bytes.fromhex(READ))
            assert plant.asked == [2, 2]
            assert plant.line.cached(2, request, 9, plant.network.events.now) is None

        plant.run(main)

    def test_an_answer_to_a_read_beside_a_write_is_not_kept(self) -> None:
        """Both were on their way together: nobody knows which one the device did first."""
        plant = Plant("tcp://10.0.0.1")
        plant.url = plant.peer.url + "?max_in_flight=2"

        async def main() -> None:
            request = request_of(bytes.fromhex(READ))
            plant.delay = 0.3
            plant.ask(2, Asker(), WRITE)
            await asyncio.sleep(0.1)
            plant.delay = 0.01
            read = Asker()
            plant.ask(2, read, age=9)
            await asyncio.sleep(0.1)
            assert read.answers == [answer_of(2, 2)]
            await asyncio.sleep(0.5)
            assert plant.line.cached(2, request, 9, plant.network.events.now) is None

        plant.run(main)

    def test_a_broadcast_has_no_answer_and_is_no_silence(self) -> None:
        plant = Plant()

        async def main() -> None:
            read, written = Asker(), Asker()
            plant.ask(0, read)
            plant.ask(0, written, WRITE)
            await asyncio.sleep(2)
            assert read.answers == [f"code {NO_ANSWER}"]
            assert written.answers == [None]
            assert plant.asked == [0]
            assert not plant.unit(0).is_silent

        plant.run(main)

    def test_over_tcp_unit_0_is_a_unit(self) -> None:
        plant = Plant("tcp://10.0.0.1")
        plant.url = plant.peer.url + "?timeout=0.5"

        async def main() -> None:
            asker = Asker()
            plant.ask(0, asker)
            await asyncio.sleep(2)
            assert asker.answers == [f"83{NO_ANSWER:02x}"]
            assert plant.unit(0).is_silent

        plant.run(main)


class TestConnection:
    def test_a_device_that_is_not_there_is_told_once_and_when_it_is_back(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
        caplog.set_level(logging.WARNING, logger="libmodbus_py.services.gateway")
        plant = Plant("tcp://10.0.0.1")
        plant.url = plant.peer.url

        async def main() -> None:
            plant.network.unlisten(plant.url)
            asker = Asker()
            for _ in range(3):
                plant.ask(1, asker)
                await asyncio.sleep(3)
            assert asker.answers == [f"83{NO_ANSWER:02x}"] * 3
            assert plant.unit(1).lost == 3
            assert not plant.unit(1).is_silent
            plant.network.listen(plant.url, plant.peer._accept)
            plant.ask(1, asker)
            await asyncio.sleep(3)
            assert asker.answers[3:] == [answer_of(1, 1)]
            texts = [text.removeprefix(plant.line.url) for text in caplog.messages]
            assert len(texts) == 2
            assert texts[0].endswith("Connection refused; trying again")
            assert texts[1] == ": open again"

        plant.run(main)

    def test_the_end_answers_all_who_wait(self) -> None:
        plant = Plant()

        async def main() -> None:
            plant.silent.add(9)
            plant.ask(9, Asker())
            await asyncio.sleep(2)
            sent, waiting, trying, late = Asker(), Asker(), Asker(), Asker()
            plant.ask(1, sent)
            plant.ask(2, waiting)
            plant.ask(9, trying)
            await asyncio.sleep(0.01)
            await plant.line.close()
            refused = [f"83{NO_ANSWER:02x}"]
            assert waiting.answers == trying.answers == sent.answers == refused
            plant.ask(1, late)
            assert late.answers == [f"code {NO_ANSWER}"]
            assert plant.asked == [9, 1]

        plant.run(main)
