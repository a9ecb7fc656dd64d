"""mosquitto for tests, its subscribers, and fleets that it commands."""

import asyncio
import json
import signal
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiomqtt

from libmodbus_py import Fleet, Server
from libmodbus_py.fleet import OutputStatistics
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.services.fleet.fleets import meter, simulated, until
from tests.support.programs import HeldPort, listens, program


class Broker:
    """mosquitto, which can be killed and started again at the same port."""

    def __init__(self, folder: Path) -> None:
        self._held: list[HeldPort] = []
        self.port: int = self.new_port()
        self.url = f"mqtt://127.0.0.1:{self.port}"
        self._folder = folder
        (folder / "passwords").write_text("")
        (folder / "passwords").chmod(0o600)
        command = [program("mosquitto_passwd"), "-b", str(folder / "passwords"), "user", "secret"]
        subprocess.run(command, check=True, capture_output=True)
        self.settings = [f"listener {self.port} 127.0.0.1", "allow_anonymous true"]
        self.process: subprocess.Popen[bytes] | None = None

    def new_port(self) -> int:
        """Return a port that is this broker's while it lives, and while it is dead."""
        self._held.append(HeldPort())
        return self._held[-1].number

    def start(self) -> None:
        file = self._folder / "mosquitto.conf"
        # Root's broker stays root's, and can read what root wrote; any other user's ignores this.
        file.write_text("\n".join([*self.settings, "user root", ""]))
        self.process = subprocess.Popen(
            [program("mosquitto"), "-c", str(file)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        listens(self.process, self.port)

    def send_signal(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)
        assert self.process is not None
        self.process.wait()

    def change(self, *settings: str) -> None:
        """Start it again with more settings."""
        self.kill()
        self.settings += settings
        self.start()

    async def restart(self, statistics: OutputStatistics) -> None:
        """Kill it, and start it again when an output has noticed."""
        self.kill()
        await until(lambda: statistics.trouble)
        self.start()

    def close(self) -> None:
        """Kill it, and give its ports back."""
        self.kill()
        for port in self._held:
            port.close()


@asynccontextmanager
async def hearing(broker: Broker, *topics: str) -> AsyncIterator[list[tuple[str, Any, bool]]]:
    """Yield what a subscriber gets: the topic, the payload, and whether it was retained."""
    messages: list[tuple[str, Any, bool]] = []

    async def listen(client: aiomqtt.Client) -> None:
        async for message in client.messages:
            assert isinstance(message.payload, bytes)
            text = message.payload.decode()
            payload = json.loads(text) if text.startswith("{") else text
            messages.append((str(message.topic), payload, message.retain))

    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        for topic in topics:
            await client.subscribe(topic, 1)
        task = asyncio.create_task(listen(client))
        try:
            yield messages
        finally:
            task.cancel()
            await asyncio.wait([task])


async def publish(broker: Broker, topic: str, payload: bytes, *, retain: bool = False) -> None:
    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        await client.publish(topic, payload, 1, retain)


def plain(payload: Any) -> Any:
    """Return a state, the value of a reading, or the values of a poll by name."""
    if isinstance(payload, str):
        return payload
    if "values" in payload:
        return {name: row["value"] for name, row in payload["values"].items()}
    return payload["value"]


def payloads(messages: list[tuple[str, Any, bool]], topic: str) -> list[Any]:
    return [payload for message, payload, _ in messages if message == topic]


@asynccontextmanager
async def commanded(broker: Broker, **options: Any) -> AsyncIterator[tuple[Fleet, Any, Any]]:
    device = simulated()
    async with Server({1: device}).serving("tcp://127.0.0.1:0") as running:
        output = Mqtt(broker.url, **options)
        devices = [meter("a", running.urls[0], interval=0.02), meter("down", "tcp://127.0.0.1:1")]
        async with (
            Fleet(devices, outputs=[output]) as fleet,
            hearing(broker, "modbus/+/+/set/result") as messages,
        ):
            await until(lambda: fleet.statistics.outputs[output.name].written)
            yield fleet, messages, device
