"""
The results as a picture.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from bench.cells import (
    BLOCKING,
    BULK,
    C_CLIENT,
    C_SERVER,
    FREE,
    OUR_NAMES,
    OUR_SERVER,
    SERVER,
    TO_OURS,
    Key,
    before,
)
from bench.report import Report, machine
from bench.results import Results

OURS, C_CODE, PEER = "#1f6fb4", "#7f7f7f", "#d9a441"
# What a server is compared by; the trivial one and the hook are for the tables.
SERVER_LOADS = ("100 x 1", "1000 x 1", "8 x 16", "1000 x 16")
DRAWN_SERVERS = (OUR_SERVER, C_SERVER, "pymodbus", "pyModbusTCP")
WIDTH, ROW = 9.0, 0.32  # inches


def draw(report: Report, file: Path) -> None:
    """Write a PNG with a panel for each table that was measured."""
    results = report.results
    panels = {
        "blocking reads of 10 registers, one in flight, from libmodbus's server": [
            key for key in results.keys(BLOCKING) if key.variant == FREE
        ],
        "100 000 registers in blocks of 125, from our server": [
            key for key in results.keys(BULK) if key.variant == TO_OURS
        ],
    } | {
        f"servers, connections x requests in flight on each: {load}": [
            key for key in results.keys(SERVER) if key.variant == load and key.name in DRAWN_SERVERS
        ]
        for load in SERVER_LOADS
    }
    drawn = {title: of_today(keys) for title, keys in panels.items() if keys}
    if not drawn:
        raise SystemExit("nothing to draw: blocking, bulk and servers were left out")
    heights = [len(keys) + 1.5 for keys in drawn.values()]
    figure, rows = plt.subplots(
        len(drawn),
        figsize=(WIDTH, ROW * sum(heights)),
        height_ratios=heights,
        squeeze=False,
        layout="constrained",
    )
    for axes, (title, keys) in zip(rows[:, 0], drawn.items(), strict=True):
        draw_panel(axes, title, results, keys)
    where = machine()
    figure.supxlabel(
        f"requests a second, median of {report.rounds} rounds; {where['processor']}, "
        f"Python {where['python']}, libmodbus {where['libmodbus']}",
        fontsize=8,
    )
    figure.savefig(file, dpi=120)
    plt.close(figure)


def of_today(keys: list[Key]) -> list[Key]:
    """The state before is for the table that compares."""
    past = {before(key.name) for key in keys}
    return [key for key in keys if key.name not in past]


def draw_panel(axes: Axes, title: str, results: Results, keys: list[Key]) -> None:
    # What is not a number to compare has no bar.
    rates = [0 if results.note(key) else results.rate(key) or 0 for key in keys]
    bars = axes.barh([key.name for key in keys], rates, color=[colour(key) for key in keys])
    axes.bar_label(
        bars,
        [results.note(key)[:30] or f"{rate:,.0f}" for key, rate in zip(keys, rates, strict=True)],
        padding=3,
        fontsize=8,
    )
    axes.set_title(title, fontsize=10, loc="left")
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.xaxis.set_visible(False)
    axes.tick_params(axis="y", labelsize=8, length=0)
    axes.spines[["top", "right", "bottom"]].set_visible(False)


def colour(key: Key) -> str:
    if key.name in OUR_NAMES:
        return OURS
    return C_CODE if key.name in (C_CLIENT, C_SERVER) else PEER
