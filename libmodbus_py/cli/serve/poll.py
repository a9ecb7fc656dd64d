"""The command poll: poll a fleet of devices until a signal; SIGHUP reads the fleet file again."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from ...files.texts import compared
from ...protocol.logs import HarmlessLogger, log_reload
from ...protocol.mistakes import Problem
from ...server.running import Handler, frozen_garbage, signal_handlers
from ...services.fleet.config import DeviceConfig
from ...services.fleet.files import FleetFile, FleetFileError, load
from ...services.fleet.fleet import Fleet
from ...services.fleet.outputs.kinds import KINDS, make_output
from ...services.fleet.outputs.output import Output, check_exclusive
from ...services.fleet.statistics import FleetStatistics
from ...services.fleet.trial import overloads, trial_polls
from ...services.tasks import WriterThread
from ...system import allow_all_descriptors
from .. import arguments, logs, tracing
from ..output import RedrawnLines, Status, complain, inform
from ..parser import Parser, declare
from . import fleet as workers
from . import over_http
from .running import Hangup, notify_ready

if TYPE_CHECKING:
    from ...services.fleet.shown_fleet import PageOutput
    from ...tools.page.table_source import ShownTable

logger: HarmlessLogger = HarmlessLogger(__name__)

REDRAWN = 1.0  # seconds between two states of the screen
ON_TIME = 0.1  # seconds that a poll may begin late and still count as on time

STANDARD_OUTPUT = "-"

DESCRIPTION = """\
Poll the devices of a fleet file, and write the readings to the outputs of
the file. Without an output, readings are printed as lines of JSON, except on
a terminal."""

EPILOG = """\
The exit code is 0, or 1 if a device did not answer --once or --check, a point
had no good value at --check, an output did not take all readings of --once, a
line cannot keep its intervals, or the standard output was closed.

examples:
  libmodbus-py poll fleet.toml --check
  libmodbus-py poll fleet.toml --once --csv
  libmodbus-py poll fleet.toml --json readings.jsonl --metrics 127.0.0.1:9400
  libmodbus-py poll fleet.toml --engine nats://192.0.2.1 --zone north"""

FILES = {name: form for name, form in KINDS.items() if form}

MODES = """
--once
    poll each device once, then exit
--check
    ask each device once, and print the results as a table
"""


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, EPILOG
    declare(command, "FILE\n  fleet file, such as fleet.toml")
    declare(command.exclusive(), MODES)
    more = {"action": "append", "const": STANDARD_OUTPUT, "default": []}
    for name, form in FILES.items():
        text = f"append readings to a file as {form}; without PATH, print them; may be repeated"
        declare(command, f"--{name} [PATH]\n  {text}", **{name: more})
    over_http.add_metrics(command)
    over_http.add_page(command, "the values and the devices")
    workers.add_arguments(command)
    arguments.add_verbose(command)
    logs.add_arguments(command)
    command.set_defaults(run=_poll)


def _poll(options: argparse.Namespace) -> int:
    if options.push and options.engine is None:
        raise ValueError("--push needs --engine")
    if options.file.endswith(".csv"):
        in_file = f'a fleet file in TOML names it as map = "{options.file}", or devices'
        raise ValueError(f"{options.file} is a list: {in_file}")
    if options.once and options.engine is not None:
        raise ValueError("--once cannot be used with --engine")
    with logs.logged(options), tracing.wire_printed(is_on=options.verbose), Hangup() as hangup:
        try:
            file = load(options.file)
        except FleetFileError as error:
            for mistake in (error, *error.others):
                complain(str(mistake))
            return 2
        for note in file.notes:
            complain(note)
        allow_all_descriptors()
        if not options.check:
            return _start(options, file, hangup)
        hangup.release()
        return asyncio.run(_check(file.devices))


def _start(options: argparse.Namespace, file: FleetFile, hangup: Hangup) -> int:
    for overload in overloads(file.devices):
        logger.warning("%s", overload)
    outputs = _outputs(file, options)
    is_printed = any(getattr(output, "path", None) == STANDARD_OUTPUT for output in outputs)
    has_screen = sys.stderr.isatty() and not (is_printed and sys.stdout.isatty())
    # Frames of --verbose would be printed into the table.
    is_line = os.environ.get("TERM", "dumb") == "dumb" or options.verbose
    has_table = has_screen and sys.stdout.isatty() and not is_line
    page = None
    if options.page:
        from ...services.fleet.shown_fleet import PageOutput

        page = PageOutput()
        outputs.append(page)
    on_readings = partial(_seen, options, file, page)
    show = partial(_show, has_table) if has_screen else None
    if options.engine is not None:
        return workers.poll(options, file, outputs, on_readings, show, hangup)
    fleet = Fleet(file.devices, outputs=outputs, journal=file.make_journal())
    with on_readings(fleet):
        workers.run_to_end(_run(fleet, options, file, hangup, show))
    if not options.once:
        return 0
    counts = [line for line, is_left in _counts(fleet) if is_left]
    for line in counts:
        complain(line)
    return 1 if counts or fleet.statistics.failures else 0


def _outputs(file: FleetFile, options: argparse.Namespace) -> list[Output]:
    outputs = file.make_outputs()
    for kind in FILES:
        outputs += (make_output(kind, {"path": path}) for path in getattr(options, kind))
    if not (outputs or options.metrics or options.page or options.engine or sys.stdout.isatty()):
        outputs.append(make_output("json", {"path": STANDARD_OUTPUT}))
    check_exclusive(outputs, sources=file.sources)
    return outputs


@contextlib.contextmanager
def _seen(
    options: argparse.Namespace, file: FleetFile, page: PageOutput | None, fleet: Fleet
) -> Iterator[None]:
    """Serve the metrics and the page of a fleet while the block runs."""

    def make() -> ShownTable:
        from ...services.fleet.journal.journal_reader import past_in
        from ...services.fleet.shown_fleet import ShownFleet

        assert page is not None
        older = past_in(file.journal["path"]) if "path" in file.journal else None
        return ShownFleet(os.path.basename(options.file), fleet, page, older)

    with (
        over_http.exposed(fleet, options.metrics, to=sys.stderr),
        over_http.tables_shown(make, options),
    ):
        yield


# --- polling ------------------------------------------------------------------------------------


async def _run(
    fleet: Fleet,
    options: argparse.Namespace,
    file: FleetFile,
    hangup: Hangup,
    show: workers.Show | None,
) -> None:
    start, stop = time.monotonic(), asyncio.Event()
    requests: asyncio.Queue[list[str]] = asyncio.Queue()
    polling = asyncio.create_task(fleet.run(once=options.once))
    tasks = [polling, asyncio.create_task(_reload(fleet, options.file, file, requests))]
    tasks += [asyncio.create_task(show(fleet))] if show else []
    waiting = asyncio.create_task(stop.wait())
    handlers: dict[signal.Signals, Handler] = {
        signal.SIGINT: stop.set,
        signal.SIGTERM: stop.set,
        signal.SIGHUP: hangup.answered(requests.put_nowait),
    }
    with signal_handlers(handlers):
        hangup.release()
        await asyncio.sleep(0)
        with frozen_garbage():
            notify_ready()
            try:
                await asyncio.wait([polling, waiting], return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in (waiting, *tasks):
                    task.cancel()
                await asyncio.wait(tasks)
                if stop.is_set() or show:
                    inform(_summary(fleet, time.monotonic() - start), sys.stderr)
                    for line, _ in _counts(fleet):
                        inform(line, sys.stderr)
    if not polling.cancelled():
        polling.result()


async def _reload(
    fleet: Fleet, path: str, former: FleetFile, requests: asyncio.Queue[list[str]]
) -> None:
    """
    Read the fleet file again, in a thread, each time it is asked for, and log what changed.

    What is put in the queue is what the line says of other files.
    """
    thread = WriterThread(path)
    thread.start()
    try:
        while True:
            of_others = await requests.get()
            try:
                file = await thread.call(load, path)
                before = {name: row.config for name, row in fleet.devices.items()}
                fleet.replace(file.devices)
                line = compared(path, "device", before, {row.name: row for row in file.devices})
                if (file.outputs, file.journal) != (former.outputs, former.journal):
                    line = Problem(
                        f"{line}; its outputs have changed, and are used after a restart"
                    )
            except (TypeError, ValueError) as error:
                line = Problem(f"the former content is used: {error}")
            log_reload(logger, [line, *of_others])
    finally:
        thread.stop()


# --- on a terminal ------------------------------------------------------------------------------


async def _show(has_table: bool, fleet: Fleet) -> None:
    """Draw the status, with a table of the values or alone, again and again until cancelled."""
    from ...services.fleet.shown_fleet import fleet_lines, problems

    table, line = RedrawnLines(sys.stderr), Status()
    polls, at = 0, time.monotonic()
    try:
        with logs.called_before_lines(table.clear):
            while True:
                await asyncio.sleep(REDRAWN)
                now, statistics = time.monotonic(), fleet.statistics
                rate = (
                    f"{(statistics.polls - polls) / (now - at):.0f} polls a second,"
                    f" at most {statistics.take_worst() * 1000:.0f} ms late,"
                    f" {statistics.skipped} skipped"
                )
                up = f"{statistics.up} of {statistics.devices} devices up"
                text = "; ".join([up, *problems(fleet), rate, *_dropped(statistics)])
                polls, at = statistics.polls, now
                if has_table:
                    table.draw(fleet_lines(fleet, text))
                else:
                    line.show(text)
    finally:
        table.clear()
        line.clear()


def _dropped(statistics: FleetStatistics) -> Iterator[str]:
    for name, output in {**statistics.outputs, "journal": statistics.journal}.items():
        if output is not None and output.dropped:
            yield f"{name}: {output.dropped} dropped"


def _summary(fleet: Fleet, seconds: float) -> str:
    statistics = fleet.statistics
    return (
        f"{statistics.polls} polls in {seconds:.1f} s,"
        f" {statistics.within(ON_TIME):.1%} within {ON_TIME * 1000:.0f} ms of their time;"
        f" {statistics.failures} without an answer, {statistics.skipped} skipped;"
        f" {statistics.readings} readings"
    )


def _counts(fleet: Fleet) -> Iterator[tuple[str, bool]]:
    """Yield a line about each output and the journal, and True if it did not take all readings."""
    statistics = fleet.statistics
    for name, row in statistics.outputs.items():
        waiting = f", {row.waiting} wait in the journal" if row.waiting else ""
        text = f"{name}: {row.written} written, {row.dropped} dropped{waiting}: {row.trouble}"
        yield text.removesuffix(": "), bool(row.dropped or row.waiting)
    if (journal := statistics.journal) is not None:
        size = f"{journal.bytes / 1e6:.1f} MB"
        text = f"journal: {journal.written} written, {journal.dropped} dropped, {size}"
        yield f"{text}: {journal.trouble}".removesuffix(": "), bool(journal.dropped)


# --- trials ------------------------------------------------------------------------------------

ROW = "{:<24} {:<36} {:>4} {:>8} {:>9} {:>9}  {}"


async def _check(devices: list[DeviceConfig]) -> int:
    print(ROW.format("device", "url", "unit", "requests", "took", "interval", "result"))
    failures = 0
    async with contextlib.aclosing(trial_polls(devices)) as results:
        async for result in results:
            device, took = result.device, f"{result.seconds * 1000:.0f} ms"
            place = device.name, str(device.endpoint), device.unit
            interval = f"{device.interval:g} s"
            row = ROW.format(*place, result.requests, took, interval, result.problem or "ok")
            print(row, flush=True)
            failures += bool(result.problem)
    too_much = overloads(devices)
    for line in too_much:
        complain(str(line))
    if failures:
        complain(f"{failures} of {len(devices)} devices failed, or had bad points")
    return 1 if failures or too_much else 0
