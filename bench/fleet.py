"""
A fleet on this machine: ./run python -m bench.fleet

10 000 devices, ten behind each of 1 000 connections to servers of this package in two other
processes; 20 registers of each are read every 5 s. Wanted: 99 of 100 polls begin within
100 ms of their time, with less than 25 KiB of memory for each device. Nobody else should use
the machine meanwhile.

--workload neuron is one that Neuron publishes: 500 devices of 30 points, each 0.5 s; --workload
gateway is one of NG Gateway: 100 devices of 1000 points, each second. Each device has a connection
of its own there. --journal and --mqtt have the readings kept on the disk, and published to a
mosquitto that is started for it; --mqtt-polls as one message for each poll of a device.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from bench.children import resident_memory
from bench.memory import raise_descriptor_limit
from libmodbus_py import Device, Fleet, Limits, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig, Journal
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.statistics import LATENESS_BOUNDS

ON_TIME, WANTED_ON_TIME = 0.1, 0.99
WANTED_MEMORY = 25 * 1024

SERVERS = 2


class Workload(NamedTuple):
    """Connections, devices behind each, registers of each, and seconds from poll to poll."""

    connections: int
    units: int
    registers: int
    interval: float


WORKLOADS = {
    "ours": Workload(1000, 10, 20, 5.0),
    "neuron": Workload(500, 1, 30, 0.5),
    "gateway": Workload(100, 1, 1000, 1.0),
}


def main() -> None:
    options = parse()
    raise_descriptor_limit()
    if options.serve:
        asyncio.run(serve(options.serve, options.units, options.registers))
        return
    with ExitStack() as stack:
        share = options.connections // SERVERS
        urls = [
            url
            for _ in range(SERVERS)
            for url in stack.enter_context(servers(share, options.units, options.registers))
        ]
        outputs = [JsonOutput(options.output)] if options.output else []
        if options.mqtt or options.mqtt_polls:
            topic = "plant/{device}" if options.mqtt_polls else "plant/{device}/{name}"
            outputs.append(stack.enter_context(published(topic)))
        journal = stack.enter_context(kept()) if options.journal else None
        figures = asyncio.run(measure(urls, options, outputs, journal))
    print(told(figures))
    if options.json:
        print(json.dumps(figures))
    sys.exit(0 if figures["on_time"] >= WANTED_ON_TIME and figures["memory"] < WANTED_MEMORY else 1)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="bench.fleet",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("--workload", choices=WORKLOADS, default="ours", help="(ours)")
    parser.add_argument("--connections", type=int, metavar="N", help="(1000)")
    parser.add_argument("--units", type=int, metavar="N", help="behind each (10)")
    parser.add_argument("--registers", type=int, metavar="N", help="of each device (20)")
    parser.add_argument("--interval", type=float, metavar="S", help="seconds (5)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="measured (60)")
    parser.add_argument(
        "--output", metavar="PATH", help="have all readings written there, as lines of JSON, too"
    )
    parser.add_argument("--journal", action="store_true", help="keep all readings in a journal")
    parser.add_argument("--mqtt", action="store_true", help="publish all readings to a mosquitto")
    parser.add_argument("--mqtt-polls", action="store_true", help="... a message for each poll")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON, too")
    parser.add_argument("--serve", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    for name, value in WORKLOADS[options.workload]._asdict().items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    return options


# --- the devices ------------------------------------------------------------------------------


async def serve(connections: int, units: int, registers: int) -> None:
    devices = {unit: Device(Mapping(holding_registers=registers)) for unit in range(1, units + 1)}
    limits = Limits(max_connections=2 * connections, connections_per_address=2 * connections)
    places = ["tcp://127.0.0.1:0"] * connections
    async with Server(devices, limits=limits).serving(*places) as running:
        gc.collect()
        gc.freeze()
        print(*running.urls, flush=True)
        moving = 0
        while True:
            await asyncio.sleep(1)
            moving = (moving + 1) % 1000
            for device in devices.values():  # half of the values move
                device.mapping.holding_registers[: registers // 2] = range(
                    moving, moving + registers // 2
                )


@contextmanager
def servers(connections: int, units: int, registers: int) -> Iterator[list[str]]:
    program = [
        sys.executable,
        "-m",
        "bench.fleet",
        "--serve",
        str(connections),
        "--units",
        str(units),
        "--registers",
        str(registers),
    ]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            yield child.stdout.readline().split()
        finally:
            child.kill()


# --- the fleet --------------------------------------------------------------------------------


@contextmanager
def kept() -> Iterator[Journal]:
    """A journal on the disk of this folder, without other outputs."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        yield Journal(f"{folder}/fleet.db")


@contextmanager
def published(topic: str) -> Iterator[Mqtt]:
    """An output to a mosquitto."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    program = ["mosquitto", "-p", str(port)]
    with subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as broker:
        try:
            yield Mqtt(f"mqtt://127.0.0.1:{port}", topic=topic)
        finally:
            broker.kill()


async def measure(
    urls: list[str], options: argparse.Namespace, outputs: list[Any], journal: Journal | None
) -> dict[str, float]:
    points = RegisterMap(
        Point(f"p{at}", "holding_registers", at, scale=0.1) for at in range(options.registers)
    )
    gc.collect()
    before = resident_memory("self")
    devices = [
        DeviceConfig(f"device {at}-{unit}", url, points, unit=unit, interval=options.interval)
        for at, url in enumerate(urls)
        for unit in range(1, options.units + 1)
    ]
    fleet = Fleet(devices, outputs=outputs, journal=journal)
    async with fleet:
        gc.collect()
        gc.freeze()
        await wait(fleet, 2 * options.interval, "connecting")
        statistics = fleet.statistics
        statistics.take_worst()
        statistics.lateness[:] = [0] * len(statistics.lateness)
        polls, skipped, readings = statistics.polls, statistics.skipped, statistics.readings
        written = [output.written for output in statistics.outputs.values()]
        start, cpu = time.monotonic(), time.process_time()
        await wait(fleet, options.seconds, "measuring")
        seconds = time.monotonic() - start
        return {
            "devices": statistics.devices,
            "up": statistics.up,
            "polls": (statistics.polls - polls) / seconds,
            "points": (statistics.readings - readings) / seconds,
            "written": sum(
                output.written - before
                for output, before in zip(statistics.outputs.values(), written, strict=True)
            )
            / seconds,
            "waiting": sum(output.waiting for output in statistics.outputs.values()),
            "journal": statistics.journal.bytes if statistics.journal else 0,
            "skipped": statistics.skipped - skipped,
            "on_time": statistics.within(ON_TIME),
            "half": percentile(statistics.lateness, 0.5),
            "most": percentile(statistics.lateness, 0.99),
            "worst": statistics.take_worst(),
            "cpu": (time.process_time() - cpu) / seconds,
            "memory": (resident_memory("self") - before) / len(devices),
            "resident": resident_memory("self"),
            "dropped": sum(output.dropped for output in statistics.outputs.values()),
        }


async def wait(fleet: Fleet, seconds: float, what: str) -> None:
    for _ in range(round(seconds)):
        await asyncio.sleep(1)
        if sys.stderr.isatty():
            text = f"{what}: {fleet.statistics.up} of {fleet.statistics.devices} devices up"
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def percentile(counts: list[int], share: float) -> float:
    """The bound below which the given share of the values is."""
    left = share * sum(counts)
    for bound, count in zip((*LATENESS_BOUNDS, float("inf")), counts, strict=True):
        left -= count
        if left <= 0:
            return bound
    return float("inf")


def told(figures: dict[str, float]) -> str:
    return (
        f"{figures['up']:.0f} of {figures['devices']:.0f} devices up,"
        f" {figures['polls']:.0f} polls and {figures['points']:.0f} points a second,"
        f" {figures['skipped']:.0f} skipped\n"
        f"{figures['on_time']:.2%} began within 100 ms of their time (wanted: 99 %);"
        f" half within {figures['half'] * 1000:g} ms, 99 % within {figures['most'] * 1000:g} ms,"
        f" the worst {figures['worst'] * 1000:.0f} ms late\n"
        f"{figures['memory'] / 1024:.1f} KiB of memory for each device (wanted: less than 25),"
        f" {figures['resident'] / 1e6:.0f} MB in all, {figures['cpu']:.0%} of a processor,"
        f" {figures['cpu'] / max(figures['points'], 1) * 1e6:.2f} us for each point\n"
        f"{figures['written']:.0f} readings a second written to outputs,"
        f" {figures['waiting']:.0f} wait, {figures['dropped']:.0f} dropped,"
        f" {figures['journal'] / 1e6:.1f} MB of journal"
    )


if __name__ == "__main__":
    main()
