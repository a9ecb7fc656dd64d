"""
Writes by name that come over the engine or a broker: one worker answers, whoever was stopped or
has died; strangers cannot have anything else written or published; floods are dropped.
"""

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import nats.errors
import pytest

from libmodbus_py.fleet import Output, Reading
from libmodbus_py.services.fleet.commands import Commands
from libmodbus_py.services.workers import messages
from libmodbus_py.services.workers.records import FleetSettings
from tests.services.workers.trial import INTERVAL, LEASE, Trial, on_trial
from tests.simulation.engine import EngineClient
from tests.simulation.runner import runner_of
from tests.simulation.workers import push_fleet

INBOX = "_INBOX.u9ii73oAyVwgjXVUkC6cqN"


class Listener:
    """
    A client that hears all that is published. `messages`: subject and content of each message;
    `raw`: the last message.
    """

    raw = b""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.client: EngineClient = trial.engine.client()
        self.messages: list[tuple[str, Any]] = []

    async def begin(self) -> None:
        for subject in ("$JS.>", "$KV.>", "modbus.written.>", "_INBOX.>", "up.>"):
            await self.client.subscribe(subject, cb=self._note)

    async def _note(self, message: Any) -> None:
        self.raw = message.data
        self.messages.append((message.subject, timeless(message.data)))

    async def heard(self, subject: str, data: bytes, reply: str = "") -> list[tuple[str, Any]]:
        """Send a command, and return what is heard then."""
        self.messages.clear()
        await self.client.publish(f"modbus.write.{subject}", data, reply)
        await asyncio.sleep(2)
        return list(self.messages)

    async def ask(self, subject: str, value: object, timeout: float = 10) -> dict[str, Any]:
        """Send a command, and return the answer."""
        data = json.dumps(value).encode()
        answer = await self.client.request(f"modbus.write.{subject}", data, timeout)
        return timeless(answer.data)

    def device_of(self, worker: str) -> str:
        """Return a device that a worker polls."""
        host = self.trial.workers[worker].process.host
        last = self.trial.asked.last
        place = next(place for (place, _), (_, peer) in last.items() if peer.startswith(host))
        return f"d{self.trial.places.index(place)}-1"


def timeless(data: bytes) -> dict[str, Any]:
    outcome: dict[str, Any] = json.loads(data)
    outcome.pop("time", None)
    return outcome


def commanded(connections: int = 2) -> Callable[[Any], Any]:
    """Let a test have two workers that carry out commands, and a listener, its first argument."""

    def run(test: Callable[[Listener], Awaitable[None]]) -> None:
        trial = Trial(connections, settings=FleetSettings(LEASE, commands=True))

        async def whole() -> None:
            await trial.start("a", "b")
            await trial.settle()
            listener = Listener(trial)
            await listener.begin()
            await test(listener)
            await listener.client.close()

        trial.run(whole)

    return runner_of(run)


def no_worker(device: str) -> dict[str, Any]:
    return {"ok": False, "error": f"no worker polls {device!r} now"}


@commanded(4)
async def test_commands_are_carried_out_by_the_worker_of_the_device(to: Listener) -> None:
    for at in range(4):
        assert await to.ask(f"d{at}-1.setpoint", 20 + at) == {"ok": True}
        assert to.trial.levels.holding_registers[1] == 20 + at
    refused = await to.ask("d0-1.setpoint", {"value": 99, "id": "x"})
    assert refused.pop("error").endswith("must be in 10..30, not 99")
    assert refused == {"ok": False, "id": "x"}
    unknown = await to.ask("d0-1.setpoin", 20)
    assert unknown == {"ok": False, "error": "d0-1 has no point 'setpoin'"}
    assert to.trial.levels.holding_registers[1] == 23


@commanded()
async def test_one_worker_answers_for_an_unknown_device(to: Listener) -> None:
    outcome = {"ok": False, "error": "there is no device 'no.one'", "id": 7}
    messages = await to.heard("no%2Eone.setpoint", b'{"value": 1, "id": 7}')
    assert messages == [("modbus.written.no%2Eone.setpoint", outcome)]
    await to.heard("kälte.setpoint", b"1")
    assert "there is no device 'kälte'".encode() in to.raw
    await push_fleet(to.trial.engine, to.trial.devices(zone="north"), to.trial.settings)
    await asyncio.sleep(1)
    messages = await to.heard("d0-1.setpoint", b"20")
    assert messages == [("modbus.written.d0-1.setpoint", no_worker("d0-1"))]


@commanded(8)
async def test_a_command_to_a_device_of_a_dead_worker_is_answered_by_its_successor(
    to: Listener,
) -> None:
    """Until then no worker knows whether it was carried out."""
    device = to.device_of("a")
    to.trial.kill("a")
    with pytest.raises(nats.errors.TimeoutError):
        await to.ask(f"{device}.setpoint", 20, LEASE)
    await to.trial.all_asked(60)
    assert await to.ask(f"{device}.setpoint", 20) == {"ok": True}


@pytest.mark.parametrize("seconds", [0.6 * LEASE, 2 * LEASE])
@commanded(8)
async def test_one_worker_answers_though_the_other_one_was_stopped(to: Listener, seconds) -> None:
    device, process = to.device_of("a"), to.trial.workers["a"].process
    process.stop()
    await asyncio.sleep(seconds)
    await to.client.publish(f"modbus.write.{device}.setpoint", b"20")
    await asyncio.sleep(0.1)
    process.go_on()
    await asyncio.sleep(LEASE)
    assert to.messages == [(f"modbus.written.{device}.setpoint", {"ok": True})]
    assert to.trial.levels.holding_registers[1] == 20


async def switch(trial: Trial, commands: bool) -> None:
    settings = FleetSettings(LEASE, commands=commands)
    await push_fleet(trial.engine, trial.devices(), settings)


@commanded()
async def test_a_flood_of_commands_does_not_delay_polls(to: Listener) -> None:
    for _ in range(1000):
        await to.client.publish("modbus.write.d0-1.setpoint", b"20")
    await asyncio.sleep(2)
    assert to.trial.asked.gap < 2 * INTERVAL
    assert await to.ask("d0-1.setpoint", 21) == {"ok": True}


@commanded()
async def test_workers_follow_whether_commands_are_accepted(to: Listener) -> None:
    for value in (20, 21, 22, 23):
        if value % 2:
            with pytest.raises(nats.errors.TimeoutError):
                await to.ask("d0-1.setpoint", value, 2)
        else:
            assert await to.ask("d0-1.setpoint", value) == {"ok": True}
        assert to.trial.levels.holding_registers[1] == value - value % 2
        await switch(to.trial, bool(value % 2))
        await asyncio.sleep(0.1)


@pytest.fixture
def failures(monkeypatch: pytest.MonkeyPatch) -> list[Exception]:
    """Errors of the next subscriptions to commands."""
    subscribe = EngineClient.subscribe
    errors: list[Exception] = [nats.errors.ConnectionClosedError()] * 2

    async def fail_first(client: EngineClient, subject: str, cb: Any = None) -> Any:
        if errors and subject.startswith("modbus.write"):
            raise errors.pop()
        return await subscribe(client, subject, cb)

    monkeypatch.setattr(EngineClient, "subscribe", fail_first)
    return errors


@commanded()
async def test_a_subscription_that_fails_is_tried_again(to: Listener, failures: list[Exception]):
    assert await to.ask("d0-1.setpoint", 20) == {"ok": True}
    assert failures == []


@commanded()
async def test_waiting_commands_are_limited_and_dropped_when_the_worker_stops(
    to: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, "MOST_WAITING", 5)
    worker = next(worker for worker in to.trial.workers if to.device_of(worker) == "d0-1")
    polling = to.trial.workers[worker].polling
    numbers: list[int] = []
    # The device takes as long for a write as the push takes to arrive.
    may_end = asyncio.Event()

    async def slow(device: str, values: dict[str, int]) -> None:
        numbers.extend(values.values())
        await may_end.wait()

    polling.fleet.write = slow  # type: ignore[method-assign,assignment]
    for value in range(20, 40):
        await to.client.publish("modbus.write.d0-1.setpoint", str(value).encode())
    await asyncio.sleep(0.5)
    assert len(polling._service._tasks) == 5
    await switch(to.trial, False)
    await asyncio.sleep(0.1)
    may_end.set()
    await asyncio.sleep(1)
    assert numbers == [20]


class Broker(Output):
    """An output that is handed what each of its workers gets: all commands."""

    name = "broker"
    takes_commands = True

    def attach_commands(self, commands: Commands) -> None:
        self.commands = commands

    async def write_readings(self, readings: Sequence[Reading]) -> None: ...


@on_trial(4)
async def test_one_of_two_workers_answers_what_comes_over_a_broker(trial: Trial) -> None:
    brokers = [Broker(), Broker()]

    async def ask(device: str, point: str, value: object) -> dict[str, Any]:
        data = json.dumps(value).encode()
        outcomes = [await broker.commands.answer(device, point, data) for broker in brokers]
        (outcome,) = filter(None, outcomes)
        return timeless(outcome)

    for name, broker in zip("ab", brokers, strict=True):
        await trial.start(name, outputs=[broker])
    await trial.settle()
    for at in range(4):
        assert await ask(f"d{at}-1", "setpoint", 20 + at) == {"ok": True}
        assert trial.levels.holding_registers[1] == 20 + at
    refused = {"ok": False, "error": "there is no device 'nothing'"}
    assert await ask("nothing", "setpoint", 20) == refused
    await push_fleet(trial.engine, trial.devices(zone="north"), trial.settings)
    for worker in trial.workers.values():
        await trial.until(lambda it=worker: not it.polling.fleet.devices, LEASE)  # type: ignore[misc]
    assert await ask("d0-1", "setpoint", 20) == no_worker("d0-1")


@commanded()
async def test_outcomes_are_sent_to_inboxes_only(to: Listener) -> None:
    """A worker may purge streams, and must not do so because a command has such a reply."""
    message = ("modbus.written.d0-1.setpoint", {"ok": True})
    for reply in (
        "$JS.API.STREAM.PURGE.modbus-readings",
        "$KV.modbus-fleet.settings",
        "modbus.write.d0-1.setpoint",
        "up.and.away",
        f"_INBOX.{'x' * 4000}",
        "_GR_.a.b.$JS.API.STREAM.PURGE.modbus-readings",
    ):
        assert await to.heard("d0-1.setpoint", b"20", reply) == [message]
    for reply in (INBOX, f"{INBOX}.9", "_INBOX_operator.x", "_R_.a.b", f"_GR_.a.b.{INBOX}"):
        messages = await to.heard("d0-1.setpoint", b"20", reply)
        assert [message for message in messages if message[0] != reply] == [message]
    assert await to.heard("d0-1.setpoint", b"20", INBOX) == [(INBOX, {"ok": True}), message]


@commanded()
async def test_names_are_accepted_in_one_spelling_only(to: Listener) -> None:
    """A broker that denies modbus.write.d0-1.> does not know that d%30-1 is the same."""
    for subject in (
        "d%30-1.setpoint",
        "d0-1.se%74point",
        "d0%2d1.setpoint",
        "d0-1.setpoint%",
        "d0-1.%FF",
        "d0-1.set%0Apoint",
        f"{'d' * 101}.setpoint",
        f"{'%25' * 1500}.setpoint",
    ):
        assert await to.heard(subject, b"20", INBOX) == []
    assert await to.heard("d0-1.setpoint", b"21", INBOX)
    assert to.trial.levels.holding_registers[1] == 21


@commanded()
async def test_values_that_are_no_json_are_refused(to: Listener) -> None:
    for data in (
        b"NaN",
        b"[1, -Infinity]",
        b"1e999",
        b'{"value": 1e999}',
        b'{"value": 20, "id": "\\ud800"}',
        b'"\\udfff"',
        "20".encode("utf-16"),
        b"\xff",
        b"[" * 4000,
        b'{"a":' * 800,
        b"[[[" + b'"\\' * 2000,
    ):
        (answer, outcome) = await to.heard("d0-1.setpoint", data, INBOX)
        assert answer[0] == INBOX
        assert answer[1]["error"].startswith("it must be a value in JSON, not ")
        assert outcome[1] == answer[1]
    assert to.trial.levels.holding_registers[1] == 0
