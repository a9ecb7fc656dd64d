"""
How long one command takes from the start of its process to its end, and an import: what is paid
for each read in a shell script.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import time
from contextlib import ExitStack

from bench.cells import SERVERS, Tools, start_server

MBPOLL = "mbpoll, one read"
STARTS = 21  # of each, in turns


def measure_startup(tools: Tools, starts: int) -> dict[str, float]:
    """Return the median of each in milliseconds."""
    with ExitStack() as stack:
        server = start_server(stack, tools, next(tools.present(SERVERS)))
        commands = commands_of(tools, server.place)
        taken: dict[str, list[float]] = {name: [] for name in commands}
        for _ in range(starts):
            server.ready()
            for name, command in commands.items():
                taken[name].append(milliseconds(command))
    return {name: statistics.median(found) for name, found in taken.items()}


def commands_of(tools: Tools, port: str) -> dict[str, list[str]]:
    ours = [tools.ours, "-m", "libmodbus_py"]
    url = f"tcp://127.0.0.1:{port}"
    commands = {
        "Python, nothing": [tools.ours, "-c", "pass"],
        "libmodbus-py --version": [*ours, "--version"],
        "libmodbus-py, wrong usage": [*ours, "read"],
        "libmodbus-py, one read": [*ours, "read", url, "holding", "0"],
        "import Client": [tools.ours, "-c", "from libmodbus_py import Client"],
    }
    for name, program in (
        ("import pymodbus.client", "import pymodbus.client"),
        ("import minimalmodbus", "import minimalmodbus"),
    ):
        if subprocess.run([tools.ours, "-c", program], capture_output=True).returncode == 0:
            commands[name] = [tools.ours, "-c", program]
    if shutil.which("mbpoll"):
        read = ["-m", "tcp", "-p", port, "-a", "1", "-0", "-r", "0", "-c", "1", "-1", "127.0.0.1"]
        commands[MBPOLL] = ["mbpoll", *read]
    return commands


def milliseconds(command: list[str]) -> float:
    # As for a user, whose Python keeps compiled modules.
    surroundings = {**os.environ}
    surroundings.pop("PYTHONDONTWRITEBYTECODE", None)
    begun = time.perf_counter()
    subprocess.run(command, env=surroundings, capture_output=True, check=False)
    return (time.perf_counter() - begun) * 1000
