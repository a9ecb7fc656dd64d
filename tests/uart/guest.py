"""
The program of the virtual machine: a master on a line, and in another process its slave.
"""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import re
import threading
import time
import traceback
from itertools import pairwise
from pathlib import Path
from typing import Any

from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusError, RtuContext, Server
from libmodbus_py.binding.library import check, ffi, lib

LINE, SLAVE, OTHER = "/dev/ttyS1", "/dev/ttyS2", "/dev/ttyS3"
STRICT: dict[str, Any] = {"timeout": 3, "retries": 0}
RETRIES: dict[str, Any] = {"timeout": 1, "retries": 3}


class Library:
    """libmodbus itself."""

    def __init__(self, device: str, rate: int, parity: str, *bits: int) -> None:
        self._line = lib.modbus_new_rtu(device.encode(), rate, parity.encode(), *bits)
        lib.modbus_set_slave(self._line, 1)
        lib.modbus_set_response_timeout(self._line, 3, 0)
        check(lib.modbus_connect(self._line))
        lib.modbus_flush(self._line)

    def write_register(self, address: int, value: int) -> None:
        check(lib.modbus_write_register(self._line, address, value))

    def read_holding_registers(self, address: int, count: int) -> list[int]:
        cells = ffi.new("uint16_t[]", count)
        check(lib.modbus_read_registers(self._line, address, count, cells))
        return list(cells)

    def serve(self) -> None:
        mapping, request = lib.modbus_mapping_new(0, 0, 200, 0), ffi.new("uint8_t[]", 260)
        while True:
            lib.modbus_reply(self._line, request, lib.modbus_receive(self._line, request), mapping)

    def close(self) -> None:
        lib.modbus_close(self._line)


class Awaited:
    """An AsyncClient with the methods of a Client."""

    def __init__(self, url: str, **options: Any) -> None:
        self._runner, self._client = asyncio.Runner(), AsyncClient(url, **options)

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self._runner.run(getattr(self._client, name)(*arguments))


def make_master(name: str, scheme: str, settings: dict[str, Any], **options: Any) -> Any:
    if name == "libmodbus":
        return Library(LINE, *settings.values())
    if name == "RtuContext":
        return RtuContext(LINE, timeout=3, **settings)
    kind = {"Client": Client, "AsyncClient": Awaited}[name]
    return kind(f"{scheme}://{LINE}", unit=1, **settings, **options)


def serve(name: str, scheme: str, settings: dict[str, Any], ready: Any, writes: Any) -> None:
    def count(_access: object) -> None:
        writes.value += 1

    mapping = Mapping(holding_registers=200)
    if name == "Server":
        url = f"{scheme}://{SLAVE}?" + "&".join(f"{key}={settings[key]}" for key in settings)
        with Server(Device(mapping, after_write=count)).background(url):
            ready.set()
            threading.Event().wait()
    if name == "libmodbus":
        library = Library(SLAVE, *settings.values())
        ready.set()
        library.serve()
    with RtuContext(SLAVE, **settings) as slave:
        ready.set()
        while True:
            if (request := slave.receive()) is not None:
                slave.reply(request, mapping)


class Run:
    """Requests of one row, whose errors are kept, and how many of their results were wrong."""

    def __init__(self, line: Any, number: int, options: Any, settings: Any, writes: Any) -> None:
        self.line, self.number, self.options, self.settings = line, number, options, settings
        self.writes, self.wrong, self.errors = writes, 0, list[Exception]()

    def attempt(self, function: Any, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except (OSError, ModbusError) as error:
            self.errors.append(error)

    def refused(self, name: str = "Client", **settings: Any) -> None:
        """Open the port as another program does, to which this must not be possible."""
        if process := os.fork():
            self.wrong += os.waitpid(process, 0)[1] != 0
            return
        master = make_master(name, "rtu", self.settings | settings)
        self.attempt(master.read_holding_registers, 0, 1)
        print("   ", *self.errors)
        os._exit(not self.errors)

    def mixed(self) -> None:
        """Write registers and read them."""
        model: list[int | None] = [None] * 100
        for index in range(self.number):
            address, size, failures = index // 2 * 7 % 90, 1 + index % 10, len(self.errors)
            if index % 2:
                cells = self.attempt(self.line.read_holding_registers, address, size) or ()
                pairs = zip(cells, model[address : address + size], strict=False)
                self.wrong += any(expected not in (None, cell) for cell, expected in pairs)
            else:
                self.attempt(self.line.write_register, address, index * 31 & 0xFFFF)
                model[address] = index * 31 & 0xFFFF if len(self.errors) == failures else None

    def heartbeats(self) -> None:
        """Write the same without a pause; the server carries out each."""
        for _ in range(self.number):
            self.attempt(self.line.write_register, 1, 3)
        self.wrong += abs(self.writes.value - self.number)

    def another_master(self) -> None:
        """Share the line with a program that knows nothing of this."""
        if (process := os.fork()) == 0:
            other = Library(OTHER, *self.settings.values())
            while True:
                time.sleep(0.3)
                self.attempt(other.read_holding_registers, 100, 30)
        self.mixed()
        os.kill(process, 9)

    def rts(self) -> None:
        """Watch RTS while frames of a second are sent, and when another program comes."""

        def state() -> tuple[str, bool]:
            (text,) = re.findall("^1: .*", Path("/proc/tty/driver/serial").read_text(), re.M)
            return re.findall(r"tx:\d+", text)[0], "RTS" in text

        def watch() -> None:
            while not is_over.wait(0.01):
                states.append(state())

        is_over, states, is_on = threading.Event(), [state()], self.options["rs485"] == "rts-up"
        thread = threading.Thread(target=watch)
        thread.start()
        for _ in range(self.number):
            self.line.write_registers(0, [*range(10)])
        is_over.set()
        thread.join()
        changes = [after for before, after in pairwise(states) if before[0] != after[0]]
        self.wrong += sum(after[1] is not is_on for after in changes) + (state()[1] is is_on)
        self.refused()
        print("    RTS behind a second opener:", "on" if state()[1] else "off")
        self.mixed()

    def no_such_rate(self) -> None:
        self.line.close()
        self.refused("Client", baudrate=230400)
        self.refused("RtuContext", baudrate=230400)

    def unplugged(self) -> None:
        """Take the UART of each side away, and give it back."""
        for port in (1, 2):
            device = Path(f"/sys/class/tty/ttyS{port}/device").resolve()
            driver = (device / "driver").resolve()
            for action, lost in (("unbind", self.number), ("bind", 0)):
                (driver / action).write_text(device.name)
                for _ in range(8 if action == "bind" else 1):  # until a server has opened its port
                    self.errors.clear()
                    self.attempt(self.line.read_holding_registers, 0, 1)
                    if not self.errors:
                        break
                self.errors.clear()
                self.mixed()
                print(f"    {action} {device.name}:", *self.errors[-1:])
                self.wrong += len(self.errors) != lost
        self.errors.clear()


# What is done; who asks, who answers; scheme, baud rate, form, number; options of the client; what
# the cable changes, loses and doubles; how many transactions may be lost. None may be wrong.
ROWS: list[Any] = [
    (Run.rts, "Client", "libmodbus", "rtu", 300, "8N1", 2, STRICT | {"rs485": "rts-up"}),
    (Run.rts, "Client", "libmodbus", "rtu", 300, "8N1", 2, STRICT | {"rs485": "rts-down"}),
    (Run.no_such_rate, "Client", "libmodbus", "rtu", 9600, "8N1", 2),
    (Run.unplugged, "Client", "Server", "rtu", 9600, "8N1", 2, {"timeout": 1}),
    (Run.another_master, "Client", "Server", "rtu", 19200, "8E1", 20, {}, "0 0 0", 20),
    (Run.mixed, "Client", "Server", "rtu", 9600, "8E1", 100, RETRIES, "0.002 0 0", 20),
    (Run.mixed, "Client", "Server", "rtu", 9600, "8E1", 100, RETRIES, "0 0.002 0", 20),
    (Run.mixed, "Client", "Server", "ascii", 9600, "7E1", 100, RETRIES, "0 0 0.002", 20),
    (Run.mixed, "Client", "Server", "rtu", 1200, "8E1", 40),
    (Run.mixed, "AsyncClient", "Server", "rtu", 9600, "8N2", 1000),
    (Run.mixed, "Client", "Server", "rtu", 115200, "8N1", 3500),
    (Run.mixed, "AsyncClient", "Server", "rtu", 115200, "8E1", 1500),
    (Run.mixed, "Client", "libmodbus", "rtu", 19200, "8E1", 1000),
    (Run.mixed, "Client", "libmodbus", "rtu", 115200, "8N1", 1500),
    (Run.mixed, "Client", "RtuContext", "rtu", 57600, "8N2", 1000),
    (Run.mixed, "libmodbus", "Server", "rtu", 1200, "8N1", 40),
    (Run.mixed, "libmodbus", "Server", "rtu", 38400, "8E1", 2000),
    (Run.mixed, "libmodbus", "RtuContext", "rtu", 115200, "8N1", 2000),
    (Run.mixed, "RtuContext", "Server", "rtu", 115200, "8N1", 1500),
    (Run.mixed, "RtuContext", "libmodbus", "rtu", 57600, "8E1", 1000),
    (Run.mixed, "Client", "Server", "ascii", 1200, "7E1", 20),
    (Run.mixed, "AsyncClient", "Server", "ascii", 9600, "7E1", 300),
    (Run.mixed, "Client", "Server", "ascii", 115200, "8N1", 1000),
    (Run.heartbeats, "libmodbus", "Server", "rtu", 9600, "8N1", 2000),
    (Run.heartbeats, "Client", "Server", "rtu", 115200, "8N1", 1500),
    (Run.heartbeats, "Client", "Server", "ascii", 115200, "7E1", 500),
]


def run(
    work: Any, master: str, slave: str, scheme: str, rate: int, form: str, number: int,
    options: dict[str, Any] = STRICT, faults: str = "0 0 0", may_lose: int = 0,
) -> bool:  # fmt: skip
    bits, parity, stop_bits = int(form[0]), form[1], int(form[2])
    print(f"cable {(1 + bits + (parity != 'N') + stop_bits) / rate} {faults}")
    input()
    settings = {"baudrate": rate, "parity": parity, "data_bits": bits, "stop_bits": stop_bits}
    ready, writes = multiprocessing.Event(), multiprocessing.Value("i", 0)
    arguments = (slave, scheme, settings, ready, writes)
    server = multiprocessing.Process(target=serve, args=arguments)
    server.start()
    ready.wait(60)
    line = make_master(master, scheme, settings, **options)
    row = Run(line, number, options, settings, writes)
    work(row)
    line.close()
    server.kill()
    server.join()
    what = f"{work.__name__}: {master}, {slave}".replace("_", " ")
    counts = f"{number:6} {row.wrong:5} {len(row.errors):4}"
    print(f"{what:36} {scheme:5} {rate:6} {form} {counts}", *row.errors[-1:])
    return not row.wrong and len(row.errors) <= may_lose


def main() -> None:
    libc = ctypes.CDLL(None)
    for kind, place in (("proc", "/proc"), ("sysfs", "/sys"), ("devtmpfs", "/dev")):
        libc.mount(kind.encode(), place.encode(), kind.encode(), 0, None)
    os.mkdir("/dev/shm")
    try:
        multiprocessing.set_start_method("fork")
        results = [run(*row) for row in ROWS]
        print("all is right" if all(results) else f"{results.count(False)} rows are wrong")
    except BaseException:
        traceback.print_exc()
    finally:
        libc.reboot(0x01234567)


main()
