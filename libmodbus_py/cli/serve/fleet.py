"""Fleets on several machines: poll --engine, which is one worker, and the command fleet."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import math
import signal
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from typing import Any, TypeVar

from ...protocol.logs import HarmlessLogger
from ...server.running import signal_handlers
from ...services.engine import connection as engine
from ...services.engine.buckets import Bucket, open_bucket
from ...services.fleet.files import FleetFile
from ...services.fleet.fleet import Fleet
from ...services.fleet.journal.schema import JournalError
from ...services.fleet.outputs.output import Output, OutputError
from ...services.workers import contents
from ...services.workers.contents import PushCounts
from ...services.workers.polling import Polling
from ...services.workers.records import BUCKET, Connection, FleetSettings, in_key
from .. import arguments
from ..main import CommandError
from ..output import complain, print_json
from ..parser import Parser, declare
from .running import Hangup, notify_ready

logger: HarmlessLogger = HarmlessLogger(__name__)

DESCRIPTION = "Print the workers that poll a fleet together, and the devices that each polls."

EPILOG = """\
The exit code is 0, or 1 if the engine does not answer or no worker polls a
part of the fleet.

examples:
  libmodbus-py fleet status --engine nats://192.0.2.1
  libmodbus-py fleet status --engine nats://192.0.2.1,nats://192.0.2.2
  libmodbus-py fleet status --engine nats://192.0.2.1 --json
  libmodbus-py fleet status --engine tls://192.0.2.1"""

ENGINE = """
--engine URLS
    the NATS servers (with JetStream) through which workers share devices:
    nats://HOST[,nats://HOST...]"""

OF_WORKERS = """
--push
    write the devices of FILE to the engine, then exit
--zone NAME ...
    poll devices of this zone too, besides those without a zone; may be repeated
--worker NAME
    name of this worker, in place of the host's"""

Exposed = Callable[[Fleet], contextlib.AbstractContextManager[Any]]

Show = Callable[[Fleet], Coroutine[Any, Any, None]]

T = TypeVar("T")

OF_PUSH = "the devices of the engine are polled, not those of the file; --push replaces them"
"""A line that answers SIGHUP."""

# Seconds between two attempts while the engine does not answer, and for all attempts of --push:
# servers that have just started take up to 10 seconds to elect a leader.
PAUSE = 0.5
ELECTION = 30.0


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, EPILOG
    text = f"STATUS\n  print the status of the fleet\n{ENGINE}"
    what = {"dest": "what", "metavar": "status", "choices": ["status"]}
    declare(command, text, status=what, engine={"required": True})
    arguments.add_forms(command)
    command.set_defaults(run=_fleet)


def add_arguments(command: Parser) -> None:
    group = command.group("several machines")
    declare(group, f"{ENGINE}{OF_WORKERS}", zone={"default": []}, worker={"default": ""})


def poll(
    options: argparse.Namespace,
    file: FleetFile,
    outputs: Sequence[Output],
    exposure: Exposed,
    show: Show | None,
    hangup: Hangup,
) -> int:
    """Poll as one worker of a fleet until a signal, or only write the file to the engine."""
    servers = engine.parse_servers(options.engine)
    settings = FleetSettings(**file.engine)
    connections = contents.connections_of(file.devices, settings.lease)
    for zone in options.zone:
        in_key(zone)
    if options.push:
        return run_to_end(_push(servers, settings, connections))

    async def work() -> int:
        hung_up = hangup.answered(lambda lines: logger.warning("%s", "; ".join([OF_PUSH, *lines])))
        # From now on, though NATS may elect a leader for a while.
        with signal_handlers({signal.SIGHUP: hung_up}):
            hangup.release()
            changes: list[Callable[[], None]] = []
            name = f"libmodbus-py {options.worker}".strip()
            async with _engine(servers, name, lambda: changes[0]() if changes else None) as client:
                bucket, current = await _opened(client, settings, connections)
                polling = Polling(
                    client,
                    bucket,
                    current,
                    name=options.worker,
                    zones=options.zone,
                    outputs=outputs,
                    journal=journal,
                )
                changes.append(polling.engine_changed)
                leaving = {signal.SIGINT: polling.leave, signal.SIGTERM: polling.leave}
                screen = asyncio.create_task(show(polling.fleet)) if show else None
                try:
                    with signal_handlers(leaving), exposure(polling.fleet):
                        notify_ready()
                        await polling.run()
                finally:
                    if screen is not None:
                        screen.cancel()
        return 0

    journal = file.make_journal()
    return run_to_end(work())


def run_to_end(running: Coroutine[Any, Any, T]) -> T:
    """Run a fleet or a question about it to its end, and raise what ends a command."""
    try:
        return asyncio.run(running)
    except (engine.EngineError, JournalError, OutputError) as error:
        if isinstance(error, OutputError) and isinstance(error.__cause__, OSError):
            raise error.__cause__ from None
        raise CommandError(str(error)) from None


# --- the bucket ----------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def _engine(
    servers: list[str], name: str, on_change: Callable[[], None] = lambda: None
) -> AsyncIterator[Any]:
    client = await engine.open_connection(servers, name=name, on_change=on_change)
    try:
        yield client
    finally:
        await engine.disconnect(client)


async def _push(servers: list[str], settings: FleetSettings, connections: list[Connection]) -> int:
    async with _engine(servers, "libmodbus-py push") as client:
        counts = await _answered(lambda: _pushed(client, settings, connections), ELECTION)
    new, changes, removals = counts
    print(f"{len(connections)} connections: {new} new, {changes} changed, {removals} gone")
    return 0


async def _answered(ask: Callable[[], Coroutine[Any, Any, T]], limit: float = math.inf) -> T:
    """
    Ask until the engine answers: while it elects a leader it does not.

    After `limit` seconds the last reason is raised. Reasons alternate; each is logged once.
    """
    give_up = time.monotonic() + limit
    names: set[str] = set()
    while True:
        try:
            return await ask()
        except engine.EngineGone as error:
            if time.monotonic() > give_up:
                raise
            if str(error) not in names:
                names.add(str(error))
                logger.warning("waiting for the engine: %s", error)
        await asyncio.sleep(PAUSE)


async def _pushed(
    client: Any, settings: FleetSettings, connections: list[Connection]
) -> PushCounts:
    bucket = await open_bucket(client, BUCKET, create=True)
    return await contents.push(bucket, settings, connections)


async def _opened(
    client: Any, settings: FleetSettings, connections: list[Connection]
) -> tuple[Bucket, FleetSettings]:
    """Return the bucket; if it does not exist, make it with the devices of the file."""
    try:
        bucket = await _answered(lambda: open_bucket(client, BUCKET))
    except engine.NoBucket:
        await _answered(lambda: _pushed(client, settings, connections))
        logger.warning("the engine had no fleet; the devices of the file were written to it")
        bucket = await _answered(lambda: open_bucket(client, BUCKET))
    view, current = await _answered(lambda: contents.read_fleet(bucket))
    if any(contents.changes(view, settings, connections)):
        logger.warning(
            "the fleet in the engine differs from the file and is polled; --push replaces it"
        )
    return bucket, current


# --- status --------------------------------------------------------------------------------------


def _fleet(options: argparse.Namespace) -> int:
    return run_to_end(_status(engine.parse_servers(options.engine), options.json))


async def _status(servers: list[str], as_json: bool) -> int:
    async with _engine(servers, "libmodbus-py status") as client:
        status = await contents.fleet_status(await open_bucket(client, BUCKET))
    if as_json:
        print_json(status)
    else:
        print(contents.tables(status), flush=True)
    for name, zone in status["zones"].items():
        if not zone["workers"]:
            zone_text = f"zone {name!r}" if name else "devices without a zone"
            complain(f"no worker polls {zone_text}")
    return 0 if contents.is_polled(status) else 1
