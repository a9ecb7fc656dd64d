"""The program of a virtual machine: a master on a line, and in another process its slave."""

import asyncio
import ctypes
import multiprocessing
import os
import select
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusError, RtuContext, Server
from libmodbus_py.binding.library import check, ffi, lib

LINE, SLAVE, OTHER = "/dev/ttyS1", "/dev/ttyS2", "/dev/ttyS3"
WRITES = 150  # the register in which a server counts the writes that it carries out

ROWS = """
rts          Client      libmodbus  rtu     1200 8N1    2 timeout=3&rs485=rts-up          0/0/0
rts          Client      libmodbus  rtu     1200 8N1    2 timeout=3&rs485=rts-down        0/0/0
no_such_rate Client      libmodbus  rtu     9600 8N1    2 timeout=3                       0/0/0
unplugged    Client      Server     rtu     9600 8N1    4 timeout=1                       0/0/0
two_masters  Client      Server     rtu    19200 8E1   20 timeout=1&retries=3&silence=0.6 0/0/0
mixed        Client      Server     rtu    19200 8E1  100 timeout=1&retries=3             2/0/0
mixed        Client      Server     rtu     1200 8E1   10 timeout=3                       0/0/0
mixed        Client      Server     rtu    19200 8E1  100 timeout=1&retries=3             0/2/0
mixed        Client      Server     ascii  19200 7E1  100 timeout=1&retries=3             0/0/2
mixed        Client      Server     ascii   1200 7E1   10 timeout=3                       0/0/0
mixed        AsyncClient Server     rtu     9600 8N2  100 timeout=3                       0/0/0
mixed        AsyncClient Server     ascii  19200 7E1  100 timeout=3                       0/0/0
mixed        libmodbus   Server     rtu   115200 8E1 3000 timeout=3                       0/0/0
mixed        Client      Server     rtu   115200 8N1 4000 timeout=3                       0/0/0
mixed        RtuContext  libmodbus  rtu   115200 8E1 3000 timeout=3                       0/0/0
mixed        Client      libmodbus  rtu   115200 8N1 3000 timeout=3                       0/0/0
mixed        AsyncClient Server     rtu   115200 8E1 1000 timeout=3                       0/0/0
mixed        libmodbus   RtuContext rtu   115200 8N1 2500 timeout=3                       0/0/0
mixed        RtuContext  Server     rtu    57600 8N1  500 timeout=3                       0/0/0
mixed        Client      RtuContext rtu    38400 8N2  500 timeout=3                       0/0/0
heartbeats   Client      Server     rtu   115200 8N1 1000 timeout=3                       0/0/0
heartbeats   libmodbus   Server     rtu   115200 8N1 1000 timeout=3                       0/0/0
mixed        Client      Server     ascii 115200 8N1  500 timeout=3                       0/0/0
heartbeats   Client      Server     ascii 115200 7E1  300 timeout=3                       0/0/0
"""
"""
What is done, by whom, and who answers; scheme, baud rate, form; number of transactions; options of
the client; of 1000 bytes, how many the cable changes, loses and doubles.
"""


class Library:
    """libmodbus itself: its functions, as the methods of a context."""

    def __init__(self, device: str, rate: int, parity: str, *bits: int, timeout: int) -> None:
        self._line = lib.modbus_new_rtu(device.encode(), rate, parity.encode(), *bits)
        self._mapping = lib.modbus_mapping_new(0, 0, 200, 0)
        self.set_slave(1)
        self.set_response_timeout(timeout, 0)

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: check(getattr(lib, f"modbus_{name}")(self._line, *arguments))

    def read_holding_registers(self, address: int, count: int) -> list[int]:
        cells = ffi.new("uint16_t[]", count)
        self.read_registers(address, count, cells)
        return list(cells)

    def receive(self) -> Any:
        request = ffi.new("uint8_t[]", 260)
        return request, check(lib.modbus_receive(self._line, request))

    def reply(self, request: Any, _mapping: Mapping) -> None:
        check(lib.modbus_reply(self._line, *request, self._mapping))


class Awaited:
    """An AsyncClient with the methods of a Client."""

    def __init__(self, url: str) -> None:
        self._runner, self._client = asyncio.Runner(), AsyncClient(url)

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self._runner.run(getattr(self._client, name)(*arguments))


CLIENTS: dict[str, Any] = {"Client": Client, "AsyncClient": Awaited}
CONTEXTS: dict[str, Any] = {"RtuContext": RtuContext, "libmodbus": Library}


def fails(function: Callable[..., object], *arguments: int) -> bool:
    """Print why requests fail, and return whether they do."""
    try:
        function(*arguments)
    except (OSError, ModbusError) as error:
        print("   ", error)
        return True
    return False


class Row:
    """A master, a slave in another process, and what they do on a line."""

    def __init__(self, text: str) -> None:
        self.text, (self.work, self.master, self.slave, self.scheme, *words) = text, text.split()
        rate, form, number, self.options, self.faults = words
        bits, stop_bits, self.number = int(form[0]), int(form[2]), int(number)
        self.settings: dict[str, Any] = {"baudrate": int(rate), "parity": form[1]}
        self.settings |= {"data_bits": bits, "stop_bits": stop_bits}
        self.character = (1 + bits + (form[1] != "N") + stop_bits) / int(rate)
        self.cells: list[int | None] = [0] * 100

    def run(self) -> int:
        """Print how long the work takes, and return the number of its transactions."""
        start, ready = time.monotonic(), multiprocessing.Event()
        self.set_cable(self.faults)
        slave = multiprocessing.Process(target=self.serve, args=(ready,), daemon=True)
        slave.start()
        assert ready.wait(60)
        self.line = self.open(self.master)
        self.line.connect()
        getattr(self, self.work)()
        self.line.close()
        slave.kill()
        print(self.text, f"{time.monotonic() - start:3.0f} s")
        return self.number

    def set_cable(self, faults: str) -> None:
        print("cable", self.character, *faults.split("/"))
        input()

    def open(self, kind: str, device: str = LINE) -> Any:
        if kind in CONTEXTS:
            return CONTEXTS[kind](device, *self.settings.values(), timeout=3)
        url = f"{self.scheme}://{device}?{urlencode(self.settings)}"
        return CLIENTS[kind](f"{url}&unit=1&{self.options}") if kind in CLIENTS else url

    def serve(self, ready: Any) -> None:
        def count(_access: object) -> None:
            mapping.holding_registers[WRITES] += 1

        slave, mapping = self.open(self.slave, SLAVE), Mapping(holding_registers=200)
        if self.slave == "Server":
            server = Server(Device(mapping, after_write=count))
            server.serve_forever(slave, on_listening=lambda _: ready.set())
            return
        slave.connect()
        ready.set()
        while True:
            slave.reply(slave.receive(), mapping)

    def mixed(self, number: int = 0) -> None:
        """Write registers and read them."""
        for index in range(0, number or self.number, 2):
            address, value, first = index * 7 % 100, index * 31 & 0xFFFF, index * 3 % 90
            self.cells[address] = None  # what it is until the response has come
            self.line.write_register(address, value)
            self.cells[address] = value
            cells = self.line.read_holding_registers(first, 1 + index % 10)
            known = self.cells[first : first + 1 + index % 10]
            assert all(x in (None, y) for x, y in zip(known, cells, strict=True)), (known, cells)

    def heartbeats(self) -> None:
        """Write the same without a pause; the server carries out each."""
        for _ in range(self.number):
            self.line.write_register(1, 3)
        assert self.line.read_holding_registers(WRITES, 1) == [self.number]

    def two_masters(self) -> None:
        """Share the line with another master; both wait longer than answers take."""
        if not (process := os.fork()):
            other = self.open("libmodbus", OTHER)
            other.connect()
            while True:
                while select.select([other.get_socket()], [], [], 0.3)[0]:
                    os.read(other.get_socket(), 256)
                fails(other.read_holding_registers, 100, 30)
                time.sleep(1)
        lost = sum(fails(self.mixed, 2) for _ in range(self.number // 2))
        os.kill(process, 9)
        assert lost <= 2

    def rts(self) -> None:
        """Look at RTS while bytes are sent and after them; then let another program come."""

        def state() -> tuple[str, bool]:
            """Return what the driver says about the UART: how many bytes it sent, and RTS."""
            words = Path("/proc/tty/driver/serial").read_text().splitlines()[2]
            return words.split()[4], "RTS" in words

        is_up = "rts-up" in self.options
        for _ in range(self.number):
            request = threading.Thread(target=self.line.write_registers, args=(100, [*range(30)]))
            states = [state()]
            request.start()
            while request.is_alive():
                states.append(state())
            sending = {after[1] for before, after in pairwise(states) if before[0] != after[0]}
            assert sending == {is_up} != {state()[1]}, states
        if not (process := os.fork()):
            os._exit(not fails(self.open("Client").read_holding_registers, 0, 1))
        assert os.waitpid(process, 0)[1] == 0
        self.mixed()

    def no_such_rate(self) -> None:
        self.line.close()
        self.settings["baudrate"] = 230400
        for kind in ("Client", "RtuContext"):
            assert fails(self.open(kind).read_holding_registers, 0, 1)

    def unplugged(self) -> None:
        """Take the UART of each side away, and give it back."""
        for port in ("ttyS1", "ttyS2"):
            device = Path("/sys/class/tty", port, "device").resolve()
            driver = (device / "driver").resolve()
            self.set_cable("0/1000/0")  # QEMU would keep for the UART what is sent to it
            (driver / "unbind").write_text(device.name)
            for _ in range(self.number // 2):
                assert fails(self.line.write_register, 100, 0)
                assert fails(self.line.read_holding_registers, 0, 1)
            (driver / "bind").write_text(device.name)
            self.set_cable("0/0/0")
            while fails(self.line.read_holding_registers, 0, 1):
                pass  # until the server has opened it
            self.mixed()


libc = ctypes.CDLL(None)
for kind, place in ((b"proc", b"/proc"), (b"sysfs", b"/sys"), (b"devtmpfs", b"/dev")):
    libc.mount(kind, place, kind, 0, None)
os.mkdir("/dev/shm")
part, machines = map(int, sys.argv[1:])
print("transactions", sum(Row(text).run() for text in ROWS.splitlines()[1 + part :: machines]))
