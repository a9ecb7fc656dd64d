"""
The command scan: the units that answer, their settings, and the tables that they have; on one line,
or on the hosts of a range such as 192.0.2.0/24.
"""

from __future__ import annotations

import argparse
import re
import socket
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from ipaddress import ip_network
from typing import Any

from ...ports.hosts import host_and_port
from ...ports.options import SERIAL_OPTIONS
from ...ports.schemes import DEFAULT_PORT
from ...protocol.errors import ModbusConnectionError
from ...protocol.pdu.interface import OBJECT_NAMES
from ...protocol.tables import joined
from ...tools.scan import probe
from ...tools.scan.scan import FoundUnit, Progress, Scan, scan
from ...tools.scan.search import MOST_REQUESTS, Extent, Searching, search
from .. import arguments
from ..arguments import with_options
from ..main import INTERRUPTED
from ..output import Status, counted, duration, missing, print_json, progress
from ..parser import Parser, declare

MOST_IN_ALL = 10 * MOST_REQUESTS
"""Requests of all searches together, at most."""

MOST_SHOWN = 60
"""Characters of an identification that are printed, at most."""

MOST_HOSTS, MANY_HOSTS = 65_536, 1024
"""Hosts of a range, at most; and those that are tried without a question."""

AT_ONCE = 64
"""Hosts that are tried at the same time."""

RANGE = re.compile(r"(?:tcp://)?\[?([0-9A-Fa-f.:]+/[0-9]{1,3})\]?(?::([0-9]{1,5}))?")

QUICK_BAUDRATES = tuple(dict.fromkeys(baudrate for baudrate, _ in probe.USUAL))

QUICK_PARITIES = tuple(dict.fromkeys(parity for _, parity in probe.USUAL))

DESCRIPTION = """\
Ask each unit for one register at each setting of the line, and print those
that answer; usual settings and units come first. Nothing is written. A baud
rate, parity, unit or timeout in the URL limits the search to it. A range such
as 192.0.2.0/24 tries each host, and scans those that accept a connection."""

EXAMPLES = """\
The exit code is 0 if a unit was found, 1 if none was found or the line failed,
130 on Ctrl-C.

examples:
  libmodbus-py scan /dev/ttyUSB0 --quick
  libmodbus-py scan /dev/ttyUSB0 -b 9600,19200 -p none,even -u 1-20,42
  libmodbus-py scan 192.0.2.10 -u 1,17,255 --deep --json
  libmodbus-py scan 192.0.2.10 -u 7 --deep --values > copy.toml"""

ARGUMENTS = f"""
--quick
    try usual settings and units only: {",".join(map(str, QUICK_BAUDRATES))};
    {",".join(QUICK_PARITIES)}; {{}}
--yes
    try more than 1024 hosts without a question
--deep
    find the tables and ranges of each unit, in at most {MOST_REQUESTS} requests to each, and print
    a device file of them
--values
    with --deep, add the values that were read, for a copy of the device
"""

OF_LINES = f"""
-b --baudrate --baudrates LIST
    baud rates to try ({",".join(map(str, probe.BAUDRATES))})
-p --parity --parities LIST
    parities to try, such as none,even ({",".join(probe.PARITIES)}); none is tried with 2 stop
    bits, which finds devices with 1 stop bit too
"""


def add_command(command: Parser) -> None:
    command.description, command.epilog = DESCRIPTION, f"{EXAMPLES}\n\n{arguments.URLS}"
    declare(command, arguments.URL)
    arguments.add_units(command, "units to ask, such as 1,5,9-12 (1-247; on networks also 255)")
    declare(command, ARGUMENTS.format(_units(probe.USUAL_UNITS)))
    arguments.add_forms(command, json="print JSON, one object in the end")
    arguments.add_client_options(
        command.group("requests"),
        without=("unit",),
        usual=lambda: {"timeout": f"{probe.ON_LINES:g}; on networks {probe.ON_NETWORKS:g}"},
    )
    baudrate, parity = (
        {"dest": dest, "type": arguments.read_as(SERIAL_OPTIONS[name].form, ",")}
        for name, dest in (("baudrate", "baudrates"), ("parity", "parities"))
    )
    parity["complete"] = arguments.lists_of_parities
    group = arguments.add_serial_options(command, without=("baudrate", "parity"))
    declare(group, OF_LINES, baudrate=baudrate, parity=parity)
    arguments.add_security_options(command)
    command.set_defaults(run=_scan)


def _scan(options: argparse.Namespace) -> int:
    if options.values and not options.deep:
        raise ValueError("--values needs --deep, which reads them")
    report = _Report(options)
    hosts = host_range(options.url)
    urls: Iterable[str] = [options.url]
    if hosts is not None:
        if not _may_go_on(len(hosts), is_confirmed=options.yes):
            return 1
        timeout = options.timeout or probe.ON_NETWORKS
        rounds = -(-len(hosts) // AT_ONCE)
        report.hosts = len(hosts)
        report.say(
            f"{counted(report.hosts, 'host')}, {duration(rounds * timeout)} at most, and more for"
            " each host that accepts a connection; Ctrl-C stops the scan"
        )
        options.quick = options.quick or options.units is None
        urls = _listening(hosts, timeout)
    is_stopped = True
    try:
        for url in urls:
            _scan_place(options, report, url)
        if options.deep:
            _search(report)
        is_stopped = False
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        report.end(stopped=is_stopped)
    return 0 if report.found else 1


def _scan_place(options: argparse.Namespace, report: _Report, url: str) -> None:
    is_one = url == options.url
    endpoint = with_options([url], options)[0]
    settings = {name: getattr(options, name) for name in ("baudrates", "parities", "units")}
    if options.quick:
        usual: dict[str, Any] = {"units": [*probe.USUAL_UNITS, *[255] * (not endpoint.is_serial)]}
        if endpoint.is_serial:
            usual |= {"baudrates": QUICK_BAUDRATES, "parities": QUICK_PARITIES}
        settings = {name: value or usual.get(name) for name, value in settings.items()}
    units = scan(endpoint.url, on_progress=report.progress, **settings)
    place = "" if is_one else f"{url}: "
    report.say(f"{place}{_estimate(units, options.deep)}")
    try:
        with units:
            for unit in units:
                report.add(unit, place)
    except ModbusConnectionError:
        if is_one:
            raise
        report.notes.append(f"{url}: the connection was lost")
    finally:
        report.notes += units.notes
        report.tried |= units.tried


def _estimate(scan: Scan, deep: bool) -> str:
    more = f"; then up to {MOST_REQUESTS} requests to each unit found" if deep else ""
    first = at = ""
    if scan.longest_first < scan.longest:
        units = _units(probe.FIRST_UNITS)
        first = f"; units {units} come first, and take {duration(scan.longest_first)}"
    if scan.settings > 1:
        at = f" at {scan.settings} settings"
    return (
        f"{counted(len(scan.units), 'unit')}{at}, {duration(scan.longest)} at most, and "
        f"{duration(scan.longest_found)} more for each unit found{first}{more}; Ctrl-C stops the"
        " scan"
    )


def _search(report: _Report) -> None:
    budget = MOST_IN_ALL
    for unit in report.found:
        if budget < MOST_REQUESTS:
            report.notes.append(
                f"unit {unit.unit} and those after it were not searched, because {MOST_IN_ALL}"
                " requests in all are the limit"
            )
            return
        result = search(unit.url, on_progress=report.progress)
        try:
            with result:
                for _ in result:
                    pass
        finally:
            budget -= result.requests
            report.deepen(unit, result.extents, result.requests)


# --- results ---------------------------------------------------------------------------


class _Report:
    """The units found so far: printed at once, or at the end as JSON."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.found: list[FoundUnit] = []
        self.notes: list[str] = []
        self.tried: dict[str, list[int]] = {}
        self.hosts: int = 0
        self._extents: dict[str, list[Extent]] = {}
        self._as_json: bool = options.json
        self._has_values: bool = options.values
        # With --deep, all that is printed is one device file.
        self._mark = "# " * options.deep
        self._has_begun = False
        self._status = Status()

    def progress(self, state: Progress | Searching) -> None:
        self._status.show(progress(state, len(self.found)))

    def say(self, text: str) -> None:
        """Print a line to stderr, in place of the status line."""
        self._status.clear()
        self._has_begun = True  # after the estimate: wrong usage is refused before
        print(text, file=sys.stderr, flush=True)

    def add(self, unit: FoundUnit, place: str) -> None:
        self.found.append(unit)
        self._print(f"{self._mark}{place}{_line(unit)}")

    def deepen(self, unit: FoundUnit, extents: list[Extent], requests: int) -> None:
        self._extents[unit.url] = extents
        self._print(_toml(unit, extents, requests, has_values=self._has_values))

    def end(self, *, stopped: bool) -> None:
        self._status.clear()
        for note in self.notes:
            self.say(note)
        if self._as_json and self._has_begun:
            facts = [
                _plain(unit, self._extents.get(unit.url), has_values=self._has_values)
                for unit in self.found
            ]
            tries = {setting: _units(units) for setting, units in self.tried.items()}
            print_json({"found": facts, "tried": tries, "notes": self.notes, "stopped": stopped})
        elif self.tried or self.hosts:
            count = counted(len(self.found), "unit") if self.found else "no unit"
            self.say(f"tried {self._all_tried()}: {count} found{' so far' * stopped}")

    def _all_tried(self) -> str:
        if self.hosts:
            hosts = counted(self.hosts, "host")
            return f"{len(self.tried)} of {hosts}, those that accepted a connection"
        settings: dict[str, list[str]] = {}
        for setting, units in self.tried.items():
            settings.setdefault(_units(units), []).append(_form(setting))
        return "; ".join(
            f"unit{'s' * (not units.isdigit())} {units} at {', '.join(at)}"
            for units, at in settings.items()
        )

    def _print(self, text: str) -> None:
        if not self._as_json:
            self._status.clear()
            print(text, flush=True)


def _line(unit: FoundUnit) -> str:
    what = "" if unit.exception is None else f", exception {unit.exception}"
    late = ", late" * unit.is_late
    who = "any unit" if unit.is_any else f"unit {unit.unit}"
    parts = [f"{who}{_at(unit)}: {unit.took * 1000:.0f} ms{what}{late}"]
    if unit.identification is not None:
        objects = sorted(unit.identification.objects.items())
        parts.append(", ".join(_safe(value) for _, value in objects if value))
    if unit.server_id is not None:
        parts.append(f"server id {_safe(unit.server_id.data)}")
    return "; ".join(part for part in parts if part)


def _at(unit: FoundUnit) -> str:
    """Return the setting at which a unit was found, such as " at 9600 8E1"; "" on networks."""
    if unit.baudrate is None:
        return ""
    form = f"{unit.data_bits}{unit.parity}{unit.stop_bits}"
    return f" at {_form(f'{unit.baudrate} {form}')}"


def _form(setting: str) -> str:
    """Return all settings that one such as 9600 8N2 finds: receivers check one stop bit only."""
    return re.sub("([0-9]N)2$", r"\g<1>1 or \g<1>2", setting)


def _units(units: Iterable[int]) -> str:
    """Return units as they are typed, such as "1-10,17"."""
    ranges = joined(range(unit, unit + 1) for unit in units)
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in ranges)


def _safe(data: bytes) -> str:
    """Return text without control characters, short enough for a line."""
    text = "".join(chr(byte) if 0x20 <= byte < 0x7F else f"\\x{byte:02x}" for byte in data)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def _toml(unit: FoundUnit, extents: list[Extent], requests: int, *, has_values: bool) -> str:
    """Return the tables of a unit, as a device file describes them."""
    lines = [f"\n# unit {unit.unit}{_at(unit)}: {requests} requests"]
    lines += [f"# {extent.table}: {text}" for extent in extents if (text := missing(extent))]
    lines += ["[[unit]]"] + [f"id = {unit.unit}"] * (not unit.is_any)
    for extent in extents:
        for range_, values in zip(extent.ranges, extent.values, strict=True):
            lines += [f"\n[[unit.{extent.table}]]", f"address = {range_.start}"]
            if has_values:
                lines.append(f"values = {values}")
            elif len(range_) > 1:
                lines.append(f"count = {len(range_)}")
    return "\n".join(lines)


def _plain(unit: FoundUnit, extents: list[Extent] | None, *, has_values: bool) -> dict[str, Any]:
    # fmt: off
    names = (
        "unit", "url", "baudrate", "parity", "data_bits", "stop_bits", "took", "exception",
        "is_late", "is_any",
    )
    # fmt: on
    fields = {name: getattr(unit, name) for name in names} | {"took": round(unit.took, 4)}
    fields["server_id"] = None if unit.server_id is None else unit.server_id.data.hex()
    fields["identification"] = None
    if unit.identification is not None:
        fields["identification"] = {
            OBJECT_NAMES.get(number, str(number)): value.decode("ascii", "backslashreplace")
            for number, value in unit.identification.objects.items()
        }
    if extents is not None:
        fields["tables"] = {
            extent.table: {
                "ranges": [
                    {"address": part.start, "count": len(part)}
                    | ({"values": values} if has_values else {})
                    for part, values in zip(extent.ranges, extent.values, strict=True)
                ],
                "unseen": extent.unseen,
                "ended": extent.ended,
                "most": extent.most,
                "requests": extent.requests,
            }
            for extent in extents
        }
    return fields


# --- ranges of hosts ---------------------------------------------------------------------------


def host_range(text: str) -> list[tuple[str, int]] | None:
    """Return host and port of each host of a range such as 192.0.2.0/24:1502; None for others."""
    match = RANGE.fullmatch(text)
    if match is None:
        return None
    try:
        network = ip_network(match[1], strict=False)
    except ValueError as error:
        raise ValueError(f"{text!r}: {error}") from None
    if network.num_addresses > MOST_HOSTS:
        raise ValueError(
            f"{text!r} has {network.num_addresses} hosts, and a scan tries {MOST_HOSTS} at most"
        )
    port = int(match[2] or DEFAULT_PORT)
    if not 1 <= port <= 65535:
        raise ValueError(f"{text!r}: the port must be in 1..65535")
    return [(str(host), port) for host in network.hosts()]


def _may_go_on(count: int, *, is_confirmed: bool) -> bool:
    """Return True if so many hosts may be tried; on a terminal, ask the user if there are many."""
    if count <= MANY_HOSTS or is_confirmed:
        return True
    if not sys.stdin.isatty():
        raise ValueError(
            f"{count} hosts are more than {MANY_HOSTS}: --yes tries them without a question"
        )
    print(f"try {count} hosts? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _listening(hosts: list[tuple[str, int]], timeout: float) -> Iterator[str]:
    """Yield the URL of each host that accepts a connection within a time, in their order."""

    def accepts(host: tuple[str, int]) -> bool:
        try:
            socket.create_connection(host, timeout).close()
        except OSError:
            return False
        return True

    pool = ThreadPoolExecutor(AT_ONCE, "scan-host")
    try:
        for host, is_there in zip(hosts, pool.map(accepts, hosts), strict=True):
            if is_there:
                yield f"tcp://{host_and_port(*host)}"
    finally:
        pool.shutdown(cancel_futures=True)
