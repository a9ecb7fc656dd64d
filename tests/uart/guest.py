"""
The program of the virtual machine: a master on a line, and in another process its slave.
"""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import select
import threading
import time
import traceback
from itertools import pairwise
from pathlib import Path
from typing import Any

from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusError, RtuContext, Server
from libmodbus_py.binding.library import check, ffi, lib

LINE, SLAVE, OTHER = "/dev/ttyS1", "/dev/ttyS2", "/dev/ttyS3"


class Library:
    """libmodbus itself."""

    def __init__(self, device: str, rate: int, parity: str, *bits: int) -> None:
        self._line = lib.modbus_new_rtu(device.encode(), rate, parity.encode(), *bits)
        lib.modbus_set_slave(self._line, 1)
        lib.modbus_set_response_timeout(self._line, 3, 0)
        check(lib.modbus_connect(self._line))
        lib.modbus_flush(self._line)
        self.descriptor = lib.modbus_get_socket(self._line)

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


def state(port: int) -> list[str]:
    """Return the words of the driver about a port: what it counts, and its lines that are on."""
    lines = Path("/proc/tty/driver/serial").read_text().replace("|", " ").splitlines()
    return next(line.split() for line in lines if line.startswith(f"{port}:"))


class Row:
    """Requests on a line, the errors of those that were lost, and how many results were wrong."""

    def __init__(
        self, work: Any, master: str, slave: str, scheme: str, rate: int, form: str, number: int,
        options: dict[str, Any] | None = None, faults: str = "0 0 0", may_lose: int = 0,
    ) -> None:  # fmt: skip
        bits, parity, stop_bits = int(form[0]), form[1], int(form[2])
        self.settings: dict[str, Any] = {
            "baudrate": rate, "parity": parity, "data_bits": bits, "stop_bits": stop_bits,
        }  # fmt: skip
        self.character = (1 + bits + (parity != "N") + stop_bits) / rate
        self.master, self.scheme, self.options = master, scheme, options or {"timeout": 3}
        self.number, self.wrong, self.errors = number, 0, list[Exception]()
        self.set_cable(faults)
        ready, self.writes = multiprocessing.Event(), multiprocessing.Value("i", 0)
        arguments = (slave, scheme, self.settings, ready, self.writes)
        server = multiprocessing.Process(target=serve, args=arguments)
        server.start()
        ready.wait(60)
        self.line, start = self.make_master(master), time.monotonic()
        work(self)
        self.line.close()
        server.kill()
        server.join()
        what, seconds = f"{work.__name__}: {master}, {slave}", round(time.monotonic() - start)
        counts = number, self.wrong, len(self.errors), seconds
        print(FORMAT.format(what.replace("_", " "), scheme, rate, form, *counts), *self.errors[-1:])
        self.is_right = not self.wrong and len(self.errors) <= may_lose

    def make_master(self, name: str, **others: Any) -> Any:
        settings = self.settings | others
        if name == "libmodbus":
            return Library(LINE, *settings.values())
        if name == "RtuContext":
            return RtuContext(LINE, timeout=3, **settings)
        kind = {"Client": Client, "AsyncClient": Awaited}[name]
        return kind(f"{self.scheme}://{LINE}", unit=1, **settings, **self.options)

    def set_cable(self, faults: str) -> None:
        print(f"cable {self.character} {faults}")
        input()

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
        master = self.make_master(name, **settings)
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
                self.wrong += any(value not in (None, cell) for cell, value in pairs)
            else:
                self.attempt(self.line.write_register, address, index * 31 & 0xFFFF)
                model[address] = index * 31 & 0xFFFF if len(self.errors) == failures else None

    def heartbeats(self) -> None:
        """Write the same without a pause; the server carries out each."""
        for _ in range(self.number):
            self.attempt(self.line.write_register, 1, 3)
        self.wrong += abs(self.writes.value - self.number)

    def another_master(self) -> None:
        """Share the line with another master; both wait longer than answers take."""
        if (process := os.fork()) == 0:
            other = Library(OTHER, *self.settings.values())
            while True:
                while select.select([other.descriptor], [], [], 0.3)[0]:
                    os.read(other.descriptor, 256)
                self.attempt(other.read_holding_registers, 100, 30)
                time.sleep(1)
        self.mixed()
        os.kill(process, 9)

    def rts(self) -> None:
        """Watch RTS while frames of a second are sent, and when another program comes."""

        def watch() -> None:
            while not is_over.wait(0.01):
                states.append(state(1))

        is_over, states, is_on = threading.Event(), [state(1)], self.options["rs485"] == "rts-up"
        thread = threading.Thread(target=watch)
        thread.start()
        for _ in range(self.number):
            self.line.write_registers(0, [*range(10)])
        is_over.set()
        thread.join()
        states_ = [after for before, after in pairwise(states) if before[4] != after[4]]
        self.wrong += sum(("RTS" in words) is not is_on for words in states_)
        self.wrong += not states_ or ("RTS" in state(1)) is is_on
        self.refused()
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
            self.set_cable("0 1 0")  # QEMU would keep for the UART what is sent to it
            (driver / "unbind").write_text(device.name)
            self.mixed()
            print(f"    without {device.name}:", *self.errors[-1:])
            self.wrong += len(self.errors) != self.number
            self.errors.clear()
            (driver / "bind").write_text(device.name)
            while port == 2 and "DTR" not in state(port):  # until the server has opened it
                time.sleep(0.1)
            self.set_cable("0 0 0")
            self.mixed()


FORMAT = "{:36} {:6} {:>6} {:3} {:>6} {:>5} {:>4} {:>3}"
RETRIES: dict[str, Any] = {"timeout": 1, "retries": 3}
SHARED = RETRIES | {"silence": 0.6}

# What is done: who asks, who answers; scheme, baud rate, form, number; options of the client; what
# the cable changes, loses and doubles; how many transactions may be lost. None may be wrong.
ROWS: list[Any] = [
    (Row.rts, "Client", "libmodbus", "rtu", 300, "8N1", 2, {"timeout": 3, "rs485": "rts-up"}),
    (Row.rts, "Client", "libmodbus", "rtu", 300, "8N1", 2, {"timeout": 3, "rs485": "rts-down"}),
    (Row.no_such_rate, "Client", "libmodbus", "rtu", 9600, "8N1", 2),
    (Row.unplugged, "Client", "Server", "rtu", 9600, "8N1", 4),
    (Row.another_master, "Client", "Server", "rtu", 19200, "8E1", 20, SHARED, "0 0 0", 2),
    (Row.mixed, "Client", "Server", "rtu", 9600, "8E1", 100, RETRIES, "0.002 0 0"),
    (Row.mixed, "Client", "Server", "rtu", 9600, "8E1", 100, RETRIES, "0 0.002 0"),
    (Row.mixed, "Client", "Server", "ascii", 9600, "7E1", 100, RETRIES, "0 0 0.002"),
    (Row.mixed, "Client", "Server", "rtu", 1200, "8E1", 20),
    (Row.mixed, "AsyncClient", "Server", "rtu", 9600, "8N2", 200),
    (Row.mixed, "Client", "Server", "rtu", 115200, "8N1", 2000),
    (Row.mixed, "AsyncClient", "Server", "rtu", 115200, "8E1", 1000),
    (Row.mixed, "Client", "libmodbus", "rtu", 115200, "8N1", 1000),
    (Row.mixed, "Client", "RtuContext", "rtu", 57600, "8N2", 500),
    (Row.mixed, "libmodbus", "Server", "rtu", 38400, "8E1", 1000),
    (Row.mixed, "libmodbus", "RtuContext", "rtu", 115200, "8N1", 500),
    (Row.mixed, "RtuContext", "Server", "rtu", 115200, "8N1", 500),
    (Row.mixed, "RtuContext", "libmodbus", "rtu", 57600, "8E1", 500),
    (Row.mixed, "Client", "Server", "ascii", 1200, "7E1", 10),
    (Row.mixed, "AsyncClient", "Server", "ascii", 19200, "7E1", 200),
    (Row.mixed, "Client", "Server", "ascii", 115200, "8N1", 500),
    (Row.heartbeats, "libmodbus", "Server", "rtu", 9600, "8N1", 500),
    (Row.heartbeats, "Client", "Server", "rtu", 115200, "8N1", 500),
    (Row.heartbeats, "Client", "Server", "ascii", 115200, "7E1", 300),
]


def main() -> None:
    libc = ctypes.CDLL(None)
    for kind, place in (("proc", "/proc"), ("sysfs", "/sys"), ("devtmpfs", "/dev")):
        libc.mount(kind.encode(), place.encode(), kind.encode(), 0, None)
    os.mkdir("/dev/shm")
    try:
        multiprocessing.set_start_method("fork")
        print(FORMAT.format("what: master, slave", "", "baud", "", "number", "wrong", "lost", "s"))
        rows = [Row(*row) for row in ROWS]
        counts = zip(*((row.number, row.wrong, len(row.errors)) for row in rows), strict=True)
        print(FORMAT.format("total", "", "", "", *map(sum, counts), ""))
        print("all is right" if all(row.is_right for row in rows) else "not all is right")
    except BaseException:
        traceback.print_exc()
    finally:
        libc.reboot(0x01234567)


main()
