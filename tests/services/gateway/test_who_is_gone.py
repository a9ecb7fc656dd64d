"""Requests of clients that left are not sent; and the cost of a silent function."""

import asyncio

import pytest

from libmodbus_py import Route
from libmodbus_py.services.gateway.line import NO_ANSWER, ForwardedRequest
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
    adu,
    answer_of,
    gateway,
    on_line,
)
from tests.simulation.lan import Lan
from tests.simulation.scripted import Scripted
from tests.support.driver import rtu

STREAMS = ["tcp://10.0.0.1", "tls://10.0.0.1", "rtu+tcp://10.0.0.1"]

LINES = [LINE, "ascii:///dev/line", "udp://10.0.0.1", "rtu+udp://10.0.0.1", *STREAMS]

CONNECT_DELAY = 1.0


def mute(url: str, options: str) -> Plant:
    """Return a plant of which no unit answers."""
    plant = Plant(f"{url}?{options}")
    plant.peer.on_request = lambda request, write: None
    return plant


@pytest.mark.parametrize("url", LINES)
def test_a_request_of_a_gone_client_is_not_sent_when_the_connection_opens(url: str) -> None:
    plant = mute(url, f"timeout=5&connect_delay={CONNECT_DELAY}")

    async def main() -> None:
        requests = [
            plant.ask(1, Asker(), WRITE),
            plant.ask(2, Asker(), merge=True),
            plant.ask(2, Asker(), merge=True),
        ]
        await asyncio.sleep(CONNECT_DELAY / 2)
        for request in requests:
            plant.line.leave(request)
        assert plant.line.statistics.in_flight == 0
        await asyncio.sleep(2 * CONNECT_DELAY)
        assert plant.peer.requests == []
        plant.ask(3, Asker())
        await asyncio.sleep(2 * CONNECT_DELAY)
        assert len(plant.peer.requests) == 1

    plant.run(main)


@pytest.mark.parametrize("url", LINES)
def test_an_unanswered_request_of_a_gone_client_is_not_repeated(url: str) -> None:
    plant = mute(url, "timeout=0.5&retries=3")

    async def main() -> None:
        request = plant.ask(1, Asker())
        await asyncio.sleep(0.1)
        plant.line.leave(request)
        await asyncio.sleep(5)
        assert len(plant.peer.requests) == 1

    plant.run(main)


@pytest.mark.parametrize("url", STREAMS)
def test_a_trial_of_a_gone_client_is_not_sent_when_the_connection_opens(url: str) -> None:
    plant = mute(url, f"timeout=0.5&connect_delay={CONNECT_DELAY}")

    async def main() -> None:
        plant.ask(9, Asker())
        await asyncio.sleep(CONNECT_DELAY + 3 * TIMEOUT + 0.2)
        assert len(plant.peer.requests) == 1
        plant.peer.drop_all()
        await asyncio.sleep(0.1)
        trial = plant.ask(9, Asker())
        await asyncio.sleep(CONNECT_DELAY / 2)
        plant.line.leave(trial)
        await asyncio.sleep(2 * CONNECT_DELAY)
        assert len(plant.peer.requests) == 1
        again = Asker()  # the unit is still due
        plant.ask(9, again)
        await asyncio.sleep(2 * CONNECT_DELAY)
        assert len(plant.peer.requests) == 2
        assert again.answers == [REFUSED]

    plant.run(main)


@pytest.mark.parametrize(("scheme", "is_sent"), [("tcp", False), ("rtu+tcp", True)])
def test_a_broadcast_of_a_gone_client_is_not_sent(lan: Lan, scheme, is_sent):
    """On a serial line nobody waits for a broadcast."""
    peer = Scripted(lan, LINE, lambda request, write: None)
    route = Route(f"{LINE}?connect_delay={CONNECT_DELAY}")
    write = bytes.fromhex(WRITE)
    frame = adu(write, unit=0) if scheme == "tcp" else rtu((b"\0" + write).hex())
    with gateway([route], f"{scheme}://10.0.0.1:0") as (_, url):
        client = lan.client(url, "10.0.0.2")
        client.sendall(frame)
        lan.pass_time(CONNECT_DELAY / 2)
        client.reset()
        lan.pass_time(2 * CONNECT_DELAY)
        assert len(peer.requests) == is_sent


@pytest.mark.parametrize(
    ("url", "unit", "requests", "timeouts"),
    [
        (LINE, 9, [UNKNOWN], 1),
        ("tcp://10.0.0.1", 9, [UNKNOWN], 1),
        (LINE, 5, [READ, INPUTS, WRITE, UNKNOWN], 1),
        # The client sends a write before the line knows that the read before it failed.
        ("tcp://10.0.0.1", 5, [READ, WRITE, UNKNOWN], 2),
    ],
)
def test_a_silent_unit_delays_reads_of_others_by_one_timeout_at_most(url, unit, requests, timeouts):
    """
    Four clients read in a row; others ask again and again what their unit does not know, or a unit
    that answers nothing.
    """
    plant = Plant(f"{url}?timeout={TIMEOUT}")
    plant.unanswered, plant.silent = {8}, {5}
    took: list[float] = []

    class Reader(Asker):
        def read(self) -> None:
            self.since = plant.network.events.now
            plant.ask(9, self)

        def take_response(self, forwarded: ForwardedRequest, response: bytes | None) -> None:
            super().take_response(forwarded, response)
            took.append(plant.network.events.now - self.since)
            if len(took) < 1000:
                self.read()

    async def main() -> None:
        readers = [Reader(f"192.0.2.{number}") for number in range(4)]
        readers[0].read()
        await asyncio.sleep(0.2)
        for reader in readers[1:]:
            reader.read()
        askers = {Asker(f"198.51.100.{number}"): request for number, request in enumerate(requests)}
        while len(took) < 1000:
            for asker, request in askers.items():
                plant.ask(unit, asker, request)
            await asyncio.sleep(0.1)
        answers = [answer for reader in readers for answer in reader.answers]
        assert {str(answer)[:4] for answer in answers} == {"0302"}
        assert plant.unit(unit).timeouts + plant.unit(unit).given_up > 1
        assert max(took) < timeouts * (TIMEOUT + 6 * plant.delay)
        # Each trial after it costs no more than an answer of the others, but for one in sixteen.
        assert len([seconds for seconds in took if seconds > 0.9 * TIMEOUT]) <= 2 * len(readers)

    plant.run(main)


@on_line("tcp://10.0.0.1?timeout=0.5")
async def test_a_write_that_tries_a_silent_unit_waits_for_others(plant: Plant) -> None:
    """Nothing is sent beside it, but others wait no longer than for one of their own answers."""
    plant.silent.add(9)
    plant.ask(9, Asker(), WRITE)
    await asyncio.sleep(2)
    for _ in range(3):
        plant.ask(1, Asker())
        await asyncio.sleep(0.1)
    writer, other = Asker(), Asker()
    plant.ask(9, writer, WRITE)
    plant.ask(1, other)
    await asyncio.sleep(3 * plant.delay)
    assert writer.answers == [f"86{NO_ANSWER:02x}"]
    assert other.answers == [answer_of(1, 6)]
    assert plant.unit(9).given_up == 1
