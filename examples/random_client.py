"""
Writes random values to a slave, and reads them back: each of the functions, on ranges of all sizes.

    python3 examples/random_client.py [PORT [HOST]]     127.0.0.1:1502 unless given

The slave has 100 coils and 100 holding registers, from address 0 on; examples/slave.py is one.
After libmodbus's random-test-client.c. The exit status is 1 if a value came back wrong.
"""

import random
import sys
from collections.abc import Callable

from libmodbus_py import TcpContext

CELLS = 100


def differs(what: str, written: object, read: object) -> bool:
    """Print what came back wrong."""
    if written != read:
        print(f"{what}: {written} was written, and {read} read")
    return written != read


def wrong_values(master: TcpContext, address: int) -> int:
    """Write and read all from an address on; return how many reads were wrong."""
    count = CELLS - address
    bits = [random.random() < 0.5 for _ in range(count)]
    words = [random.randrange(65536) for _ in range(count)]
    others = [word ^ 0xFFFF for word in words]

    def coils() -> list[bool]:
        return master.read_coils(address, count)

    def registers() -> list[int]:
        return master.read_holding_registers(address, count)

    steps: list[tuple[str, Callable[[], object], object, Callable[[], object]]] = [
        ("coil", lambda: master.write_coil(address, bits[0]), bits[0], lambda: coils()[0]),
        ("coils", lambda: master.write_coils(address, bits), bits, coils),
        ("register", lambda: master.write_register(address, words[0]), words[0],
         lambda: registers()[0]),
        ("registers", lambda: master.write_registers(address, words), words, registers),
        ("both", lambda: None, others,
         lambda: master.read_write_registers(address, count, address, others)),
        ("mask", lambda: master.mask_write_register(address, 0xFF00, 0x00FF),
         others[0] & 0xFF00 | 0x00FF, lambda: registers()[0]),
    ]  # fmt: skip
    wrong = 0
    for name, write, written, read in steps:
        write()
        wrong += differs(f"{name} at {address}", written, read())
    return wrong


def main() -> int:
    port = sys.argv[1] if len(sys.argv) > 1 else "1502"
    host = sys.argv[2] if len(sys.argv) > 2 else "127.0.0.1"
    with TcpContext(host, int(port), unit=17) as master:
        wrong = sum(wrong_values(master, address) for address in range(CELLS))
    print(f"{6 * CELLS} reads, {wrong} of them wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
