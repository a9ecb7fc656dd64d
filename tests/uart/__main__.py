"""Starts the virtual machines, and is the cable between the UARTs of each."""

import contextlib
import heapq
import multiprocessing
import random
import select
import socket
import subprocess
import sys
import threading
import time

MACHINES = 2  # of one core, at the same time
QEMU = """
qemu-system-x86_64 -accel tcg -cpu max -smp 1 -m 1024 -nodefaults -no-reboot -display none
-kernel build/uart/vmlinuz -initrd build/uart/initramfs -serial stdio -append
"""
KERNEL = "console=ttyS0 loglevel=0 panic=-1 mitigations=off tsc=reliable -- -u /site/guest.py"
UARTS = "iobase=0x2f8,irq=3", "iobase=0x3e8,irq=5", "iobase=0x2e8,irq=7"


def carry(pairs: list[tuple[socket.socket, socket.socket]], setting: list[float]) -> None:
    """
    Bring each byte to the other ends when a line would, but for what it damages.

    The setting: seconds of a character, and of 1000 bytes how many to change, lose, double.
    """
    ends = [near for near, _ in pairs]
    coming: list[tuple[float, int, int]] = []  # a heap: when, from which end, what
    last, free, dice = (0.0, 0, 0), dict.fromkeys(ends, 0.0), random.Random(1)
    while True:
        timeout = max(0.0, coming[0][0] - time.monotonic()) if coming else None
        for end in select.select(ends, [], [], timeout)[0]:
            for byte in end.recv(4096):
                changed, lost, doubled = (dice.random() < share / 1000 for share in setting[1:])
                free[end] = max(free[end], time.monotonic()) + setting[0]
                sent = free[end], end.fileno(), byte ^ changed << dice.randrange(8)
                for _ in range(1 - lost + doubled):
                    heapq.heappush(coming, sent)
        while coming and coming[0][0] <= time.monotonic():
            now, sender, byte = this = heapq.heappop(coming)
            near = [at for at, other, _ in (last, *coming[:1]) if other != sender]
            byte ^= any(abs(at - now) < setting[0] for at in near)  # two send at one time
            last = this
            for end in ends:
                if end.fileno() != sender:
                    with contextlib.suppress(BlockingIOError):  # a port that nobody has open
                        end.send(bytes([byte]), socket.MSG_DONTWAIT)


def run(part: int) -> int:
    """Run a part of the rows; return how many transactions it did, 0 if one was wrong or lost."""
    pairs, setting, number = [socket.socketpair() for _ in UARTS], [1.0], 0
    command, pipe = [*QEMU.split(), f"{KERNEL} {part} {MACHINES}"], subprocess.PIPE
    ends = [far.fileno() for _, far in pairs]
    for end, address in zip(ends, UARTS, strict=True):
        command += ["-chardev", f"socket,id=end{end},fd={end}"]
        command += ["-device", f"isa-serial,chardev=end{end},{address}"]
    machine = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, pass_fds=ends)
    threading.Thread(target=carry, args=(pairs, setting), daemon=True).start()
    for line in machine.stdout or ():
        match line.split():
            case "cable", *words:
                setting[:] = map(float, words)
                print(file=machine.stdin, flush=True)  # now the guest goes on
            case "transactions", word:
                number = int(word)
            case [_, *_]:
                print(line, end="", flush=True)
    return number


def main() -> int:
    start = time.monotonic()
    subprocess.run(["sh", "tests/uart/machine.sh", sys.executable], check=True)
    with multiprocessing.Pool(MACHINES, maxtasksperchild=1) as pool:
        numbers = pool.map(run, range(MACHINES), 1)
    print(f"{sum(numbers)} transactions, {time.monotonic() - start:.0f} s")
    print("all is right" if all(numbers) else "not all is right")
    return not all(numbers)


if __name__ == "__main__":
    sys.exit(main())
