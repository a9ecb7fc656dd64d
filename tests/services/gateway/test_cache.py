"""
Answers that a gateway gives again while they are fresh.
"""

from __future__ import annotations

import asyncio

from libmodbus_py import Device, Mapping
from libmodbus_py.services.gateway.line import MOST_CACHED, Cache, request_of
from tests.services.gateway.test_line import READ, WRITE, Asker, Plant
from tests.simulation.stage import Stage
from tests.support.gateways import passage


def test_answers_are_given_again_until_they_are_old_or_something_is_written(stage: Stage) -> None:
    reads: list[int] = []
    device = Device(
        Mapping(10, 10, 10, 10), before_read=lambda access: reads.append(access.address)
    )
    with (
        passage("tcp", "rtu", {1: device}, route={"cache": 30}, stage=stage) as through,
        through.context(1) as context,
        through.context(1) as other,
    ):
        for client in (context, other) * 5:
            assert client.read_holding_registers(2, 2) == [0, 0]
        assert len(reads) == 1
        other.write_register(3, 9)
        for client in (context, other):
            assert client.read_holding_registers(2, 2) == [0, 9]
        assert len(reads) == 2
        assert context.read_exception_status() == 0  # may change what it likes
        assert context.read_holding_registers(2, 2) == [0, 9]


def test_a_write_whose_client_goes_while_it_is_sent_makes_what_was_read_before_old() -> None:
    plant = Plant()

    async def main() -> None:
        def is_kept() -> bool:
            read, now = request_of(bytes.fromhex(READ)), asyncio.get_running_loop().time()
            return plant.line.cached(1, read, 60, now) is not None

        plant.ask(1, Asker(), age=60)
        await asyncio.sleep(1)
        assert is_kept()
        write = plant.ask(1, Asker(), WRITE)
        await asyncio.sleep(0.01)
        plant.line.leave(write)
        assert plant.asked == [1, 1]
        assert not is_kept()
        await asyncio.sleep(1)
        assert not is_kept()

    plant.run(main)


def test_the_answer_that_was_kept_first_is_dropped_for_one_too_many() -> None:
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


def test_an_answer_is_that_of_its_unit_and_request_and_no_older_than_wanted() -> None:
    cache = Cache()
    cache.keep(1, b"ask", b"answer", 10.0)
    assert cache.get(1, b"ask", 0.5, 10.5) == b"answer"
    assert cache.get(1, b"ask", 0.5, 10.6) is None
    assert cache.get(2, b"ask", 0.5, 10.0) is None
    assert cache.get(1, b"other", 0.5, 10.0) is None


def test_a_write_to_one_unit_leaves_the_others_and_a_broadcast_none() -> None:
    cache = Cache()
    units = (0, 1, 2, 255)
    for now, written, left in ((2.0, 1, {0, 2, 255}), (4.0, 0, set())):
        for unit in units:
            cache.keep(unit, b"ask", b"answer", now - 1)
        cache.forget(written, now)
        assert {unit for unit in units if cache.get(unit, b"ask", 9.0, now)} == left
        for unit in units:  # an answer that was on its way
            cache.keep(unit, b"ask", b"answer", now)
        assert {unit for unit in units if cache.get(unit, b"ask", 9.0, now)} == left
    cache.keep(1, b"ask", b"answer", 4.1)
    assert cache.get(1, b"ask", 9.0, 5.0) == b"answer"
