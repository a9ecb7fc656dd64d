"""
Servers of NATS in processes of their own, and ways to them that stop or slow down.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from random import SystemRandom
from typing import Any, Self, TypeVar

from tests.support.programs import program

__all__ = ["NatsServers", "Way", "free_ports"]

Result = TypeVar("Result")

_randrange = SystemRandom().randrange  # simulated worlds seed the usual one, in several processes

ANSWER_S = 90.0
"""Servers elect a leader within ten seconds, on a machine that does nothing else."""


def free_ports(count: int) -> list[int]:
    """Ports that no program has, and that Linux gives to no connection meanwhile."""
    found: list[int] = []
    while len(found) < count:
        port = _randrange(20_000, 32_000)
        with contextlib.suppress(OSError), socket.socket() as trial:
            trial.bind(("127.0.0.1", port))
            found.append(port)
    return found


class NatsServers:
    """
    One server of NATS with JetStream, or a cluster.

    Args:
        count: of servers.
        options: more of nats-server, for each.
        config: gives each, by its number, the text of a configuration file.
        jetstream: whether they have it.
    """

    def __init__(
        self,
        count: int = 1,
        *options: str,
        config: Callable[[int], str] | None = None,
        jetstream: bool = True,
    ) -> None:
        self._jetstream = jetstream
        self.ports: list[int] = free_ports(count)
        self._routes = free_ports(count)
        self._options = options
        self._config = config
        self._processes: list[subprocess.Popen[bytes] | None] = [None] * count

    def __enter__(self) -> Self:
        self._directory = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        for number in range(len(self.ports)):
            self.start(number)
        return self

    def __exit__(self, *_: object) -> None:
        for number in range(len(self.ports)):
            self.kill(number)
        self._directory.cleanup()

    @property
    def urls(self) -> str:
        return ",".join(f"nats://127.0.0.1:{port}" for port in self.ports)

    def start(self, number: int) -> None:
        """Start one server, perhaps again, and wait until it listens."""
        home = Path(self._directory.name, str(number))
        home.mkdir(exist_ok=True)
        command = [program("nats-server"), "-a", "127.0.0.1", "-p", str(self.ports[number])]
        command += ["-n", f"n{number}", "--ports_file_dir", str(home), *self._options]
        if self._jetstream:
            command += ["-js", "-sd", str(home)]
        if self._config is not None:
            (home / "nats.conf").write_text(self._config(number))
            command += ["-c", str(home / "nats.conf")]
        if len(self.ports) > 1:
            routes = ",".join(f"nats://127.0.0.1:{port}" for port in self._routes)
            own = f"nats://127.0.0.1:{self._routes[number]}"
            command += ["--cluster_name", "trial", "--cluster", own, "--routes", routes]
        with open(home / "log", "ab") as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=log)
        self._processes[number] = process
        until = time.monotonic() + 20
        # Another program may listen on the port; this server writes a file once it listens.
        while not any(home.glob(f"*_{process.pid}.ports")):
            if process.poll() is not None or time.monotonic() > until:
                raise RuntimeError(f"nats-server: {(home / 'log').read_text()[-2000:]}")
            time.sleep(0.02)

    def kill(self, number: int = 0) -> None:
        process = self._processes[number]
        if process is not None:
            process.kill()
            process.wait()
            self._processes[number] = None

    def ask(self, script: Callable[[Any], Awaitable[Result]], **options: Any) -> Result:
        """Run a coroutine function with a client, and return its result."""
        import nats

        async def main() -> Result:
            client = await nats.connect(self.urls.split(","), **options)
            try:
                async with asyncio.timeout(ANSWER_S):
                    return await script(client)
            finally:
                await client.close()

        return asyncio.run(main())

    def leader(self, stream: str, **options: Any) -> int:
        """The number of the server that leads a stream; options: of `nats.connect`."""

        async def find(client: Any) -> int:
            while True:  # during an election there is no leader, or no answer
                with contextlib.suppress(Exception):
                    info = await client.jetstream(timeout=2).stream_info(stream)
                    if info.cluster is not None and info.cluster.leader:
                        return int(info.cluster.leader[1:])
                await asyncio.sleep(0.1)

        return self.ask(find, connect_timeout=2, **options)


class Way:
    """
    A way to a server, which forwards bytes late, or not at all while `is_cut`.

    Args:
        port: where the server listens.

    Attributes:
        port: where this listens.
        is_cut: whether bytes stay where they are; connections stay as well.
        delay: seconds that bytes take, each way.
    """

    def __init__(self, port: int) -> None:
        self._to = port
        self.is_cut: bool = False
        self.delay: float = 0.0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._tasks: set[asyncio.Task[Any]] = set()

    def __enter__(self) -> Self:
        self._thread.start()
        starting = asyncio.start_server(self._forward, "127.0.0.1", 0)
        self._server = asyncio.run_coroutine_threadsafe(starting, self._loop).result()
        self.port: int = self._server.sockets[0].getsockname()[1]
        return self

    def __exit__(self, *_: object) -> None:
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        # Who was accepted just now has no task yet.
        for _ in range(10):
            await asyncio.sleep(0)
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        there: asyncio.StreamWriter | None = None
        try:
            while self.is_cut:
                await asyncio.sleep(0.02)
            back, there = await asyncio.open_connection("127.0.0.1", self._to)
            async with asyncio.TaskGroup() as group:
                group.create_task(self._carry(reader, there))
                group.create_task(self._carry(back, writer))
        except (OSError, ExceptionGroup):
            pass
        finally:
            for peer in (writer, there):
                if peer is not None:
                    peer.close()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        while data := await reader.read(65536):
            at = loop.time() + self.delay
            while self.is_cut or loop.time() < at:
                await asyncio.sleep(0.02)
            writer.write(data)
            await writer.drain()
        raise ConnectionResetError
