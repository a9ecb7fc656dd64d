"""
The command serve: simulated devices, until a signal ends it.

SIGHUP reads the device file again; with --reload, so does every change of the file.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping as MappingABC
from functools import partial

from ...device.device import Device
from ...device.mapping import Mapping
from ...maps.list_words import ListOptions
from ...protocol.pdu import RECORDS_PER_FILE
from ...server.server import Server
from ...server.units import UNKNOWN_UNIT_POLICIES
from ...tools.simulator import device_file, example_files
from ...tools.simulator.hooks_file import HooksFile
from ...tools.simulator.reloading import Reloader
from .. import arguments, logs
from ..arguments import OF_SERVERS, with_options
from ..parser import Parser, declare
from . import over_http
from .running import add_audit, add_limits, starting

EXAMPLE_URL = "tcp://127.0.0.1:1502"

DESCRIPTION = """\
Simulate the devices of a device file or of an example. Without either, one
device with all tables and ten files, filled with zeros, answers as every unit."""

EXAMPLES = """\
examples:
  libmodbus-py serve 127.0.0.1:1502 -u 1-10
  libmodbus-py serve tcp://0.0.0.0:502 --device plant.toml --reload --page
  libmodbus-py serve --example meter
  libmodbus-py serve /dev/ttyUSB0 -b 9600 -p none --device plant.toml"""

SOURCES = """
--device FILE
    serve the devices of a device file
--example [NAME]
    serve a device file of the package; without NAME, list them
--map FILE
    serve the points of a register map, or of one that comes with the package: with their names,
    access and bounds
--replay FILE
    answer as the devices in a capture, .pcapng or .pcap, did; other requests get exception 4
"""

OPTIONS = """
--reload
    read the device file again when the file, or a register map that it uses, changes; connections
    stay open, and a mistake in the file changes nothing
--hooks FILE.py
    call before_write(access), after_write and before_read of this file; SIGHUP reads it again
rare --own-unit N
    device that answers units 0 and 255 too, on TCP and UDP
--state FILE
    keep the values that clients write in this file, so that they survive a restart; it is written
    at most 0.5 s after a change, and at the end
"""

UNKNOWN_UNIT = """
rare --unknown-unit POLICY
    requests to units without a device, on TCP and UDP: refuse answers with an exception, silent
    does not answer (refuse)
"""


def add_command(command: Parser) -> None:
    command.description = DESCRIPTION
    command.epilog = f"{EXAMPLES}\n\n{arguments.SCHEMES_OF_URLS}"
    text = f"where to listen, such as {EXAMPLE_URL}, the default for examples"
    declare(command, f"[URL ...]\n  {text}", url={"dest": "urls"})
    example = {"const": "", "complete": lambda **_: [*example_files.DEVICES]}
    source = command.exclusive()
    declare(source, SOURCES, example=example, map={"complete": arguments.maps})
    arguments.add_columns(command, encoding=True)
    arguments.add_units(
        command, "without --device and --example: units that exist, such as 1-10,17 (all)"
    )
    declare(command, OPTIONS)
    over_http.add_metrics(command)
    over_http.add_page(command)
    policy = {"choices": UNKNOWN_UNIT_POLICIES, "default": "refuse"}
    declare(add_limits(command), UNKNOWN_UNIT, unknown_unit=policy)
    add_audit(command)
    arguments.add_verbose(command)
    logs.add_arguments(command)
    arguments.add_serial_options(command)
    arguments.add_security_options(command)
    command.set_defaults(run=_serve)


def _serve(options: argparse.Namespace) -> int:
    if options.example == "":
        return _list_examples()
    path = options.device if options.example is None else example_files.path_of(options.example)
    urls = options.urls or ([EXAMPLE_URL] if options.example is not None else [])
    if not urls:
        raise ValueError("the following arguments are required: URL")
    if path is None and (files := [url for url in urls if url.endswith((".toml", ".csv"))]):
        option = "--device" if files[0].endswith(".toml") else "--map"
        raise ValueError(f"{files[0]} is no URL: type {option} {files[0]}")
    urls = [with_option.url for with_option in with_options(urls, options, OF_SERVERS)]
    if options.reload and path is None:
        raise ValueError("--reload needs --device or --example")
    if options.units and path is not None:
        raise ValueError(f"--units cannot be given with {path}, which has its own units")
    others = [name for name in ("units", "hooks", "state") if vars(options)[name] is not None]
    if options.replay is not None and others:
        raise ValueError(f"--{others[0]} cannot be given with --replay")
    with starting(options) as command:
        simulation = _simulation(options, path)
        devices: Device | MappingABC[int, Device]
        if options.replay is not None:
            from ...tools.listener.replay import replayed_devices

            devices = replayed_devices(options.replay)
        elif simulation is None:
            devices = {unit: _everything() for unit in options.units or ()} or _everything()
        else:
            devices = simulation.devices
        server = Server(
            devices,
            faults=None if simulation is None else simulation.faults,
            unknown_unit=options.unknown_unit,
            own_unit=options.own_unit,
            state=options.state,
            **command.hooks,
        )
        hooks = None
        if options.hooks is not None:
            hooks = HooksFile(options.hooks)
            hooks.use(devices)
            command.files.append(lambda: hooks.read_again(server.devices))
        serve = partial(command.serve, server, urls, lambda: server)
        if simulation is None or path is None:
            serve()
            return 0
        reloader = Reloader(
            server, path, simulation, is_watching=options.reload, tell=command.tell, hooks=hooks
        )
        serve(begin=reloader.start, answer=reloader.ask)
    return 0


def _simulation(options: argparse.Namespace, path: str | None) -> device_file.Simulation | None:
    if options.map is not None:
        list_options = ListOptions(**arguments.list_keys(options))
        return device_file.mapped_simulation(options.map, options.units or (), list_options)
    if arguments.list_keys(options):
        raise ValueError("--column, --from and --list need --map")
    return None if path is None else device_file.load(path)


def _list_examples() -> int:
    devices = example_files.descriptions()
    width = max(map(len, devices))
    for name, description in devices.items():
        print(f"{name:{width}}  {description}")
    return 0


def _everything() -> Device:
    everything = Mapping(65536, 65536, 65536, 65536)
    files = {number: [0] * RECORDS_PER_FILE for number in range(1, 11)}
    return Device(everything, files=files)
