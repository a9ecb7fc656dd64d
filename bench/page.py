"""
What the live page costs the process of a server: 10 000 cells, all new ten times a second.

``python -m bench.page [SECONDS]`` prints the processor time of the server's process, without a
page, with Chromium on it, and with somebody who looks at all cells at once. Nobody else should
use the machine meanwhile.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.support.peers import until
from tests.tools.page.browsers import missing, person_at
from tests.tools.page.watching import Visitor

CELLS = 10_000
UPDATES = 10  # a second
TARGET = 10.0  # per cent of one core
TABLE = "1/holding_registers"

SERVER = f"""
import time
from array import array
from libmodbus_py import Device, Mapping, Server
from libmodbus_py.page import live_page

mapping = Mapping(holding_registers={CELLS})
cells = [array("H", [number % 65536] * {CELLS}) for number in range(1, 65536, 6553)]
with live_page(Server({{1: Device(mapping)}})) as page:
    print(page.url, flush=True)
    at = 0
    while True:
        at += 1
        with mapping:
            mapping.holding_registers.view[:] = cells[at % len(cells)]
        time.sleep(1 / {UPDATES})
"""


@contextlib.contextmanager
def served() -> Iterator[tuple[int, str]]:
    """Return the process and the URL of the page."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    command = [sys.executable, "-c", SERVER]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as program:
        assert program.stdout is not None
        try:
            yield program.pid, program.stdout.readline().strip()
        finally:
            program.kill()


def cpu(pid: int) -> float:
    """The seconds of processor time so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share(pid: int, seconds: float) -> float:
    """Per cent of a core, over so many seconds."""
    before, start = cpu(pid), time.monotonic()
    time.sleep(seconds)
    return 100 * (cpu(pid) - before) / (time.monotonic() - start)


def in_chromium(pid: int, url: str, seconds: float) -> tuple[float, float]:
    """Return the share, and how often in a second what is shown has changed."""
    with person_at(url) as person:
        cells = "return document.querySelectorAll('[data-cell]').length"
        until(lambda: person.run(cells))
        person.run(
            "window.updates = 0;"
            "import('/scripts/rows.js').then(({ onRows }) =>"
            "  onRows(() => { window.updates += 1; }));"
        )
        time.sleep(1)
        first = person.run("return window.updates")
        start = time.monotonic()
        found = share(pid, seconds)
        last = person.run("return window.updates")
        return found, (last - first) / (time.monotonic() - start)


def at_all_cells(pid: int, url: str, seconds: float) -> tuple[float, float]:
    """The same for a page without a view, to which all cells are sent each time."""
    visitor = Visitor(url)
    times = 0
    is_over = threading.Event()

    def read() -> None:
        nonlocal times
        while not is_over.is_set():
            visitor.receive(_changed(visitor))
            times += 1

    with visitor.watching():
        visitor.look(1, "holding_registers", 0, CELLS)
        visitor.receive(lambda: len(visitor.cells(TABLE)) == CELLS)
        reading = threading.Thread(target=read)
        reading.start()
        found = share(pid, seconds)
        is_over.set()
        reading.join()
    return found, times / seconds


def _changed(visitor: Visitor) -> Callable[[], bool]:
    before = visitor.seen[TABLE]["0"][0]
    return lambda: visitor.seen[TABLE]["0"][0] != before


def main() -> int:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    lacking = missing()
    worst = 0.0
    with served() as (pid, url):
        print(f"{CELLS} cells, {UPDATES} updates a second, {seconds:g} s each")
        print(f"  no page          {share(pid, seconds):5.1f} % of a core", flush=True)
        measured: list[tuple[str, Callable[[int, str, float], tuple[float, float]]]] = []
        measured.append(("all cells at once", at_all_cells))
        if lacking:
            print(f"  Chromium         {lacking}")
        else:
            measured.insert(0, ("Chromium", in_chromium))
        for name, measure in measured:
            found, updates = measure(pid, url, seconds)
            worst = max(worst, found)
            print(f"  {name:<17}{found:5.1f} %, {updates:.1f} updates a second", flush=True)
    print(f"target: under {TARGET:g} % of a core: {'met' if worst < TARGET else 'missed'}")
    return 0 if worst < TARGET else 1


if __name__ == "__main__":
    sys.exit(main())
