"""
Answers that wait on a serial line while its direction is turned: no more than a port itself keeps,
and the latest, because whoever asked earlier waits no longer.
"""

from __future__ import annotations

import asyncio
import os
from typing import Any

from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.serial import MAX_UNSENT, SerialServer
from libmodbus_py.server.service import SessionState
from libmodbus_py.tools.testing.wires import SerialWire

ANSWERS = [b"%04d" % number * 64 for number in range(1000)]


class Service:
    """Makes one session, which answers when it is told to."""

    def sessions(self, endpoint: Any, statistics: Any, later: Any = None) -> Any:
        def made(channel: Any) -> Service:
            self.channel = channel
            return self

        return made

    state = SessionState.READING

    def receive(self, data: bytes) -> int:
        return 0

    def end(self) -> None: ...

    def close(self) -> None: ...


async def received(wire: SerialWire, server: SerialServer, service: Service) -> bytes:
    """Return what comes of all answers, written at once."""
    await server.open()
    for answer in ANSWERS:
        service.channel.write(answer)
    loop = asyncio.get_running_loop()
    descriptor = os.open(wire.client, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    found, done = bytearray(), asyncio.Event()

    def read() -> None:
        found.extend(os.read(descriptor, 65_536))
        if found.endswith(ANSWERS[-1]):
            done.set()

    loop.add_reader(descriptor, read)
    try:
        await done.wait()
    finally:
        loop.remove_reader(descriptor)
        os.close(descriptor)
        server.close()
    return bytes(found)


def test_the_latest_answers_wait_and_no_more_than_a_port_keeps() -> None:
    service = Service()

    async def main(wire: SerialWire) -> bytes:
        url = f"rtu://{wire.server}?baudrate=115200&rs485=rts-up&rts_delay=0.01"
        server = SerialServer(parse(url), service, ServerStatistics())
        return await received(wire, server, service)

    with SerialWire() as wire:
        found = asyncio.run(main(wire))
    assert found.endswith(ANSWERS[-1])
    pieces = [found[at : at + 256] for at in range(0, len(found), 256)]
    assert pieces == [ANSWERS[0], *ANSWERS[-(MAX_UNSENT // 256) :]]
