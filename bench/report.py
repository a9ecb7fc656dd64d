"""
The results as tables to read, and as JSON.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from bench.cells import (
    ASYNCIO,
    BLOCKING,
    BULK,
    LIMIT,
    SECTIONS,
    SERVER,
    Key,
    absent,
)
from bench.memory import FEW, MANY, Memory
from bench.results import Results
from bench.startup import MBPOLL
from bench.targets import Outcome
from bench.tls import Tls
from libmodbus_py.low_level import loaded_version

DISTRIBUTIONS = ("pymodbus", "pylibmodbus", "pyModbusTCP", "uModbus", "minimalmodbus")
TITLES = {
    BLOCKING: "Blocking clients, one request of 10 registers in flight",
    ASYNCIO: "asyncio clients, requests of 10 registers; that in C has one in flight",
    BULK: "100 000 registers in blocks of 125; ours with 16 requests in flight, others with one",
    SERVER: "Servers, requests of 10 registers: connections x requests in flight on each",
    LIMIT: "The limit: two processes in C that send each other as many bytes",
}
NOTE_WIDTH = 60


@dataclass
class Report:
    """The whole report."""

    rounds: int
    seconds: float
    results: Results
    memory: dict[str, Memory | str]
    tls: Tls | None
    startup: dict[str, float]
    outcomes: list[Outcome]


# --- where it ran -----------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """Return the machine and versions that the numbers depend on."""
    return {
        "processor": processor_name(),
        "processors": len(os.sched_getaffinity(0)),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "libmodbus": ".".join(map(str, loaded_version())),
        **{name: found for name in DISTRIBUTIONS if (found := version_of(name))},
    }


def processor_name() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def version_of(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


# --- to read ----------------------------------------------------------------------------


def as_text(report: Report) -> str:
    """Return the tables."""
    parts = [head(report)]
    for section in SECTIONS:
        if keys := report.results.keys(section):
            parts.append(TITLES[section])
            tables = server_tables if section == SERVER else client_tables
            parts += tables(report.results, keys)
    if report.memory:
        parts += [
            f"Resident memory of servers with {FEW} idle connections; each more, up to {MANY}",
            memory_table(report),
        ]
    if report.tls is not None:
        parts += ["Server, us of processor time over TLS, and plain", tls_tables(report.tls)]
    if report.startup:
        parts += ["From the start of a process to its end", startup_table(report.startup)]
    if report.outcomes:
        parts += ["Targets", target_table(report.outcomes)]
    return "\n\n".join(parts)


def head(report: Report) -> str:
    lines = [f"{name}: {value}" for name, value in machine().items()]
    lines.append(f"medians of {report.rounds} rounds of {report.seconds:g} s each")
    lines += [f"left out, not installed: {name}" for name in absent()]
    return "\n".join(lines)


def startup_table(startup: dict[str, float]) -> str:
    theirs = startup.get(MBPOLL)
    rows = [
        [name, f"{took:.0f}", f"{took / theirs:.1f}" if theirs else "-"]
        for name, took in startup.items()
    ]
    return grid(["", "ms", "of mbpoll"], rows)


def tls_tables(tls: Tls) -> str:
    requests = [
        [load, f"{plain:.1f}", f"{secure:.1f}", f"{secure / plain:.2f}"]
        for load, (plain, secure) in tls.requests.items()
    ]
    handshakes = [
        [kind, f"{cost:.0f}", f"{1e6 / cost:.0f}"] for kind, cost in tls.handshakes.items()
    ]
    return "\n\n".join(
        [
            grid(["for a request", "plain", "TLS", "ratio"], requests),
            grid(["for a connection", "us", "a second, at most"], handshakes),
        ]
    )


def grid(head: list[str], rows: list[list[str]]) -> str:
    """Return a table: the first column to the left, the others to the right."""
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    return "\n".join(
        "  ".join(
            [row[0].ljust(widths[0])]
            + [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        ).rstrip()
        for row in [head, *rows]
    )


def number(value: float | None, form: str = ",.0f") -> str:
    return "-" if value is None else format(value, form)


def unique(items: Iterator[str]) -> list[str]:
    return list(dict.fromkeys(items))


def with_notes(table: str, results: Results, keys: list[Key], label: Callable[[Key], str]) -> str:
    """Add the failures below the table, and the numbers that were reached all the same."""
    lines = [table]
    for key in keys:
        if note := results.note(key):
            rate = results.rate(key)
            reached = "" if rate is None else f" ({rate:,.0f} a second)"
            lines.append(f"  {label(key)}: {note[:NOTE_WIDTH]}{reached}")
    return "\n".join(lines)


def client_tables(results: Results, keys: list[Key]) -> Iterator[str]:
    for variant in unique(key.variant for key in keys):
        rows = [key for key in keys if key.variant == variant]
        yield with_notes(client_table(results, variant, rows), results, rows, lambda key: key.name)


def client_table(results: Results, variant: str, keys: list[Key]) -> str:
    first = keys[0]
    head = [variant, "a second", f"of {first.name}", "us client", "us server"]
    return grid(head, [client_row(results, key, results.rate(first)) for key in keys])


def client_row(results: Results, key: Key, base: float | None) -> list[str]:
    if results.note(key):
        return [key.name, "fails", "", "", ""]
    rate = results.rate(key)
    return [
        key.name,
        number(rate),
        number(rate / base if rate and base else None, ".2f"),
        number(results.client_cost(key), ".1f"),
        number(results.server_cost(key), ".1f"),
    ]


def server_tables(results: Results, keys: list[Key]) -> Iterator[str]:
    columns: dict[str, tuple[Callable[[Key], float | None], str]] = {
        "requests a second": (results.rate, ",.0f"),
        "us of processor time for a request": (results.server_cost, ".1f"),
        "ms for 99 of 100 requests": (lambda key: in_milliseconds(results.latency(key)), ".2f"),
    }
    for title, (value, form) in columns.items():
        table = server_table(results, keys, title, value, form)
        is_first = value == results.rate
        yield with_notes(table, results, keys, load_label) if is_first else table


def in_milliseconds(microseconds: float | None) -> float | None:
    return None if microseconds is None else microseconds / 1e3


def load_label(key: Key) -> str:
    return f"{key.name}, {key.variant}"


def server_table(
    results: Results,
    keys: list[Key],
    title: str,
    value: Callable[[Key], float | None],
    form: str,
) -> str:
    loads = unique(key.variant for key in keys)
    rows = []
    for name in unique(key.name for key in keys):
        cells = [Key(SERVER, load, name) for load in loads]
        rows.append(
            [name, *("fails" if results.note(key) else number(value(key), form) for key in cells)]
        )
    return grid([title, *loads], rows)


def memory_table(report: Report) -> str:
    rows = []
    for name, found in report.memory.items():
        if isinstance(found, str):
            rows.append([name, "fails", "", found[:NOTE_WIDTH]])
        else:
            each = number(found.each / 1024, ".1f")
            rows.append([name, number(found.few / 2**20, ".1f"), each, found.note])
    return grid(["server", "MiB", "KiB a connection", ""], rows)


def target_table(outcomes: list[Outcome]) -> str:
    rows = [
        [
            target_title(outcome),
            f">= {outcome.target.least:g}",
            number(outcome.ratio, ".2f"),
            verdict(outcome),
        ]
        for outcome in outcomes
    ]
    return grid(["ours / theirs", "target", "measured", ""], rows)


def verdict(outcome: Outcome) -> str:
    if outcome.ratio is None:
        return "not measured"
    if outcome.is_met:
        return "met"
    return "below the aim" if outcome.target.is_aim else "MISSED"


def target_title(outcome: Outcome) -> str:
    ours, theirs = outcome.target.ours, outcome.target.theirs
    if ours.variant == theirs.variant:
        return f"{ours.section}, {ours.variant}: {ours.name} / {theirs.name}"
    return f"{ours.section}, {ours.name}: {ours.variant} / {theirs.variant}"


# --- for programs -----------------------------------------------------------------------


def as_json(report: Report) -> dict[str, Any]:
    """Return all numbers, rounds included."""
    return {
        "machine": machine(),
        "rounds": report.rounds,
        "seconds": report.seconds,
        "left_out": absent(),
        "cells": [
            cell_as_json(report.results, key)
            for section in SECTIONS
            for key in report.results.keys(section)
        ],
        "memory": {
            name: {"failed": found} if isinstance(found, str) else asdict(found)
            for name, found in report.memory.items()
        },
        "tls": None if report.tls is None else asdict(report.tls),
        "startup": report.startup,
        "targets": [
            {
                "target": target_title(outcome),
                "least": outcome.target.least,
                "ratio": outcome.ratio,
                "met": outcome.is_met,
            }
            for outcome in report.outcomes
        ],
    }


def cell_as_json(results: Results, key: Key) -> dict[str, Any]:
    return {
        **key._asdict(),
        "note": results.note(key),
        "rate": results.rate(key),
        "client_us": results.client_cost(key),
        "server_us": results.server_cost(key),
        "p99_us": results.latency(key),
        "rounds": [asdict(seconds) for seconds in results.measured.get(key, [])],
    }
