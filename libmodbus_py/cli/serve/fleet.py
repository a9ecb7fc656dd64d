"""
What needs an engine: poll --engine, one worker of several; and the command fleet, about all.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import logging
import math
import signal
import sys
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, TypeVar

from ...server.signals import Handler, signal_handlers
from ...services.engine.buckets import Bucket, make_bucket, open_bucket
from ...services.engine.connection import connected, disconnect, parse_servers
from ...services.engine.troubles import EngineError, EngineGone, NothingThere
from ...services.fleet.files import FleetFile, FleetFileError
from ...services.fleet.fleet import Fleet
from ...services.fleet.outputs.output import Output
from ...services.workers.polling import BUCKET, Polling
from ...services.workers.pushing import Pushed, changes, connections_of, push, seen_now, settings_of
from ...services.workers.records import Connection, Settings, in_key
from ...services.workers.status import fleet_status, tables
from ...tools.files.texts import load_file
from ...tools.files.toml_text import read_toml
from ..failing import CommandError
from .hangup import unless_closed

__all__ = ["add_arguments", "add_command", "poll"]

logger: logging.Logger = logging.getLogger(__name__)

ENGINE = "nats://HOST[,nats://HOST...]"

Exposed = Callable[[Fleet], contextlib.AbstractContextManager[Any]]

Show = Callable[[Fleet], Coroutine[Any, Any, None]]

T = TypeVar("T")

# Seconds: between two tries while the engine gives no answer, and for how long push tries:
# servers that have just started take up to 10 to elect a leader.
PAUSE = 0.5
ELECTION = 30.0


def add_command(commands: Any) -> None:
    """Tell argparse of the command fleet."""
    command = commands.add_parser(
        "fleet",
        description="Say what the workers do that poll a fleet on several machines.",
        epilog="exit code 0; 1 if the engine gives no answer, or nobody polls a part of the fleet",
    )
    command.add_argument("what", choices=["status"])
    command.add_argument("--engine", metavar=ENGINE, required=True, help="where NATS is")
    command.add_argument("--json", action="store_true", help="as one object of JSON")
    command.set_defaults(run=_fleet)


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Tell argparse of what poll takes for several machines."""
    group = command.add_argument_group("several machines")
    group.add_argument(
        "--engine",
        metavar=ENGINE,
        help="share the devices with all workers there (NATS with JetStream)",
    )
    group.add_argument(
        "--push", action="store_true", help="give the engine the devices of FILE, and end"
    )
    group.add_argument(
        "--zone",
        action="append",
        default=[],
        metavar="NAME",
        help="take devices of this zone, too, besides those without one; may be repeated",
    )
    group.add_argument("--worker", default="", metavar="NAME", help="instead of the host's name")


def poll(
    options: argparse.Namespace,
    file: FleetFile,
    outputs: Sequence[Output],
    exposed: Exposed,
    show: Show | None,
) -> int:
    """
    Be one worker of a fleet, until a signal; or only give the engine what is in the file.

    Args:
        exposed: what tells others of the fleet, while it is entered.
        show: draws the status line, until cancelled.
    """
    servers = parse_servers(options.engine)
    settings = load_file(options.file, _settings, FleetFileError)
    connections = connections_of(file.devices, settings.lease)
    for zone in options.zone:
        in_key(zone)
    if options.push:
        return _waited_for(_push(servers, settings, connections))
    return _waited_for(_work(servers, settings, connections, options, outputs, exposed, show))


def _settings(text: str) -> Settings:
    given = read_toml(text).get("engine", {})
    if not isinstance(given, dict):
        raise TypeError("engine must be a table")
    return settings_of(given)


def _waited_for(running: Coroutine[Any, Any, int]) -> int:
    try:
        return asyncio.run(running)
    except EngineError as error:
        raise CommandError(str(error)) from None


# --- the bucket ----------------------------------------------------------------------------------


async def _push(servers: list[str], settings: Settings, connections: list[Connection]) -> int:
    client = await connected(servers, name="libmodbus-py push")
    try:
        pushed = await _answered(lambda: _pushed(client, settings, connections), set(), ELECTION)
    finally:
        await disconnect(client)
    print(
        f"{len(connections)} connections:"
        f" {pushed.new} new, {pushed.changed} changed, {pushed.gone} gone"
    )
    return 0


async def _answered(
    ask: Callable[[], Coroutine[Any, Any, T]], told: set[str], patience: float = math.inf
) -> T:
    """
    Ask until the engine answers: one that elects a leader is there, and does not.

    Args:
        told: the reasons that were logged. Reasons alternate; each is logged once.
    """
    give_up = time.monotonic() + patience
    while True:
        try:
            return await ask()
        except EngineGone as error:
            if time.monotonic() > give_up:
                raise
            if str(error) not in told:
                told.add(str(error))
                logger.warning("waiting for the engine: %s", error)
        await asyncio.sleep(PAUSE)


async def _pushed(client: Any, settings: Settings, connections: list[Connection]) -> Pushed:
    return await push(await make_bucket(client, BUCKET), settings, connections)


async def _is_there(client: Any) -> bool:
    try:
        await open_bucket(client, BUCKET)
    except NothingThere:
        return False
    return True


async def _opened(
    client: Any, settings: Settings, connections: list[Connection]
) -> tuple[Bucket, Settings]:
    """Give the bucket, with the devices of the file if it was not there."""
    told: set[str] = set()
    if not await _answered(lambda: _is_there(client), told):
        await _answered(lambda: _pushed(client, settings, connections), told)
        logger.warning("the engine had no fleet; it has that of the file now")
    bucket = await _answered(lambda: open_bucket(client, BUCKET), told)
    view = await _answered(lambda: seen_now(bucket), told)
    if view.settings is None:
        why = view.unreadable.get("settings", "has no fleet: put it there with --push")
        raise EngineError(f"{bucket.name}: {why}")
    if any(changes(view, settings, connections)):
        logger.warning("the engine has another fleet than the file, and that is polled; see --push")
    return bucket, view.settings


# --- polling -------------------------------------------------------------------------------------


async def _work(
    servers: list[str],
    settings: Settings,
    connections: list[Connection],
    options: argparse.Namespace,
    outputs: Sequence[Output],
    exposed: Exposed,
    show: Show | None,
) -> int:
    changed: list[Callable[[], None]] = []
    client = await connected(
        servers,
        name=f"libmodbus-py {options.worker}".strip(),
        on_change=lambda: changed[0]() if changed else None,
    )
    try:
        bucket, current = await _opened(client, settings, connections)
        polling = Polling(
            client,
            bucket,
            current,
            name=options.worker,
            zones=options.zone,
            outputs=outputs,
        )
        changed.append(polling.engine_changed)
        screen = asyncio.create_task(show(polling.fleet)) if show else None
        try:
            with signal_handlers(_handlers(polling)), exposed(polling.fleet):
                await polling.run()
        finally:
            if screen is not None:
                screen.cancel()
    finally:
        await disconnect(client)
    return 0


def _handlers(polling: Polling) -> dict[signal.Signals, Handler]:
    return {
        signal.SIGINT: polling.leave,
        signal.SIGTERM: polling.leave,
        signal.SIGHUP: unless_closed(_tell_of_push),
    }


def _tell_of_push() -> None:
    logger.warning("the devices are those of the engine; see --push")


# --- status --------------------------------------------------------------------------------------


def _fleet(options: argparse.Namespace) -> int:
    return _waited_for(_status(parse_servers(options.engine), options.json))


async def _status(servers: list[str], as_json: bool) -> int:
    client = await connected(servers, name="libmodbus-py status")
    try:
        status = await fleet_status(await open_bucket(client, BUCKET))
    finally:
        await disconnect(client)
    print(json.dumps(status) if as_json else tables(status), flush=True)
    for name, zone in status["zones"].items():
        if not zone["workers"]:
            told = f"zone {name!r}" if name else "devices without a zone"
            print(f"libmodbus-py: nobody serves {told}", file=sys.stderr)
    return (
        1 if any(each["served_slots"] < each["slots"] for each in status["zones"].values()) else 0
    )
