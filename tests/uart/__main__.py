"""
Starts the virtual machine, and is the cable between its UARTs.
"""

from __future__ import annotations

import contextlib
import random
import select
import socket
import subprocess
import sys
import sysconfig
import time
from collections import deque
from pathlib import Path

HERE = Path(__file__).parent
BUILD = HERE.parents[1] / "build" / "uart"
QEMU = "qemu-system-x86_64 -accel tcg -cpu max -smp 2 -m 1024 -nodefaults -no-reboot -display none"
OPTIONS = (
    "console=ttyS0 quiet loglevel=1 panic=-1 random.trust_cpu=on no_timer_check PYTHONPATH=/site"
)
UARTS = ("iobase=0x3f8,irq=4", "iobase=0x2f8,irq=3", "iobase=0x3e8,irq=5", "iobase=0x2e8,irq=7")
"""The first is the console, on which the guest also sets the cable; it joins the others."""


class Cable:
    """Brings each byte to the other ends when a line would, but for what it damages."""

    def __init__(self, ends: list[socket.socket]) -> None:
        self._bytes: dict[socket.socket, deque[tuple[float, int]]] = {end: deque() for end in ends}
        self._sends = dict.fromkeys(ends, (0.0, 0.0))  # since when, and until when
        self._random = random.Random(1)

    def set(self, text: str) -> None:
        """Set the seconds of a character, and the shares of bytes to change, lose and double."""
        self._character, *self._shares = map(float, text.split())

    def wait(self, console: socket.socket) -> bool:
        """Wait for the next byte of anyone, and return whether the console has one."""
        due = [waiting[0][0] for waiting in self._bytes.values() if waiting]
        timeout = max(0.0, min(due) - time.monotonic()) if due else None
        readable = select.select([console, *self._bytes], [], [], timeout)[0]
        now = time.monotonic()
        for end in self._bytes.keys() & readable:
            self._take(end, end.recv(4096), now)
        for end, waiting in self._bytes.items():
            data = bytearray()
            while waiting and waiting[0][0] <= now:
                data.append(waiting[0][1] ^ self._is_disturbed(end, waiting[0][0]))
                waiting.popleft()
            for other in self._bytes.keys() - {end} if data else ():
                with contextlib.suppress(BlockingIOError):  # a port that nobody has open
                    other.send(data, socket.MSG_DONTWAIT)
        return console in readable

    def _take(self, end: socket.socket, data: bytes, now: float) -> None:
        since, until = self._sends[end]
        since, until = (since, until) if until > now else (now, now)
        for byte in data:
            changed, is_lost, doubled = (self._random.random() < share for share in self._shares)
            until += self._character
            byte ^= changed << self._random.randrange(8)
            self._bytes[end].extend([(until, byte)] * (0 if is_lost else 1 + doubled))
        self._sends[end] = since, until

    def _is_disturbed(self, end: socket.socket, due: float) -> bool:
        """Return True if another end sent at the time of a byte."""
        sends = (self._sends[other] for other in self._sends.keys() - {end})
        return any(since < due and until > due - self._character for since, until in sends)


def main() -> int:
    python = Path(sys.executable).resolve()
    words = [sys.executable, str(python), sysconfig.get_path("stdlib")]
    subprocess.run(["sh", str(HERE / "machine.sh"), *words], check=True)
    start, is_right, text = time.monotonic(), False, b""
    near, far = zip(*(socket.socketpair() for _ in UARTS), strict=True)
    command = [*QEMU.split(), "-kernel", str(BUILD / "vmlinuz"), "-append", OPTIONS]
    command += ["-initrd", str(BUILD / "initramfs")]
    for number, address in enumerate(UARTS):
        command += ["-chardev", f"socket,id=end{number},fd={far[number].fileno()}"]
        command += ["-device", f"isa-serial,chardev=end{number},{address}"]
    console, cable = near[0], Cable(list(near[1:]))
    machine = subprocess.Popen(command, pass_fds=[end.fileno() for end in far])
    for end in far:
        end.close()
    try:
        while True:
            if cable.wait(console):
                if not (data := console.recv(4096)):
                    break
                *lines, text = (text + data).split(b"\n")
                for line in filter(None, map(str.rstrip, map(bytes.decode, lines))):
                    if line.startswith("cable "):
                        cable.set(line.removeprefix("cable "))
                        console.sendall(b"\n")  # now the guest goes on
                    else:
                        print(line, flush=True)
                        is_right |= line == "all is right"
    except ConnectionError:
        pass  # the machine is off
    finally:
        machine.kill()
        machine.wait()
    print(f"{time.monotonic() - start:.0f} s")
    return not is_right


if __name__ == "__main__":
    sys.exit(main())
