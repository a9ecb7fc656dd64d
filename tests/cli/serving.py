"""Commands that serve, a device, a map and a fleet file, for the tests of commands."""

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager

from libmodbus_py import Device, Mapping
from tests.support.commands import Started

FLEET_OF_ONE = """
[[device]]
name = "one"
url = "{url}"
[[device.point]]
name = "volts"
table = "holding_registers"
address = 0
"""
"""A fleet file with one point of the device at a URL, which `format` sets."""

METER = """\
name,table,address,count,type,scale,unit,access,minimum,maximum
voltage,input_registers,0,1,uint16,0.1,V,read,,
phases,input_registers,10,3,int16,1,A,read,,
label,holding_registers,20,1,string:4,,,read_write,,
setpoint,holding_registers,30,1,int16,0.1,C,read_write,0,90
pump,coils,3,1,,,,read_write,,
"""
"""A map of the device that `meter` returns."""


def meter() -> Device:
    """Return a device with some values in each table, a file and a queue."""
    mapping = Mapping(coils=100, discrete_inputs=16, holding_registers=600, input_registers=20)
    mapping.holding_registers[0:4] = [1, 2, 3, 0xFFFC]
    mapping.holding_registers[500:503] = [500, 501, 502]
    mapping.holding_registers[20:22] = [0x6162, 0x6364]
    mapping.input_registers[0] = 2305
    mapping.input_registers[10:13] = [1, 2, 0xFFFF]
    mapping.coils[5] = True
    return Device(mapping, files={4: [7, 8, 9] + [0] * 400}, fifos={40: [5, 6]})


@contextmanager
def serving(*words: object, end: int = signal.SIGTERM) -> Iterator[tuple[Started, str]]:
    """Start a command that serves, and end it by a signal; gives it and where it listens."""
    with Started(*words) as process:
        line = process.stdout.readline()
        assert line.startswith("listening on "), line + process.stderr.read()
        yield process, line.removeprefix("listening on ").rstrip("\n")
        process.send_signal(end)
        assert process.wait() == 0


INFO = ("--log", "info")
"""The level at which a command says that it read its files again, and nothing is wrong."""


def reload_line(process: Started) -> str:
    """Return the next line about files that were read again, of a command at the level of INFO."""
    for line in process.stderr:
        if match := re.match(r"\S+ (?:info|warning) +cli\.serve\.\w+: (.*)\n", line):
            return match[1]
    raise AssertionError("no line about files")
