"""
Where a document runs: a folder, addresses and serial ports of its own, a device that answers.

=================================  =============================================================
what documents write               what it is when they run
=================================  =============================================================
127.0.0.1, localhost               an address of this process alone, so that ports are free
0.0.0.0, 0.0.0.0:502               the same, with a port that everybody may open
192.0.2.10                         there, with a server that has everything, all zero
libmodbus-py certificates          the server's has this address, too
/dev/ttyUSB0                       a serial line with the same device, RTU
/dev/ttyUSB1, /dev/ttyUSB2         the two ends of a cable
=================================  =============================================================
"""

import re
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from random import SystemRandom
from typing import Self

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.tools.testing.wires import SerialWire

DEVICE_PORT, OPEN_PORT = 10502, 5502

randrange = SystemRandom().randrange  # tests may seed the usual one


def own_address() -> str:
    """
    Return an address of this machine that nobody else uses.

    At random: containers that share a network have processes of the same number.
    """
    return f"127.{64 + randrange(128)}.{randrange(256)}.{randrange(256)}"


class Home:
    """
    `folder`: where files are, and commands run. `at_end`: what is undone when the document ends;
    `device, mapping`: who answers at 192.0.2.10 and /dev/ttyUSB0.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.at_end = ExitStack()
        self.mapping = Mapping(65536, 65536, 65536, 65536)
        self.device = Device(
            self.mapping,
            files={number: [0] * 10_000 for number in range(1, 11)},
            fifos={1246: [440, 4740]},
        )
        self.address = own_address()
        self.url = f"tcp://{self.address}:{DEVICE_PORT}"
        self.at_end.enter_context(Server(self.device).background(self.url))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.at_end.close()

    def here(self, text: str) -> str:
        """Put the addresses of this machine into what a document says."""
        for there, path in self._places.items():
            text = re.sub(there, path, text)
        return re.sub(r"/dev/ttyUSB\d", lambda port: self._ports[port[0]], text)

    def there(self, text: str) -> str:
        """Put the addresses of documents into what was printed here."""
        text = text.replace(f"{self.address}:{DEVICE_PORT}", "192.0.2.10:502")
        text = text.replace(f"{self.address}:{OPEN_PORT}", "0.0.0.0:502")
        text = text.replace(self.address, "127.0.0.1").replace(str(self.folder), ".")
        if "_ports" in vars(self):
            for name, path in self._ports.items():
                text = re.sub(rf"{path}\b", name, text)
        return text

    @cached_property
    def _places(self) -> dict[str, str]:
        served = f"{self.address}:{DEVICE_PORT}"
        return {
            r"(?<=://)192\.0\.2\.10(:502)?(?![:\d])": served,
            r'"192\.0\.2\.10"(?:, (?:port=)?502\b)?(?!, (?:port=)?\d)': (
                f'"{self.address}", port={DEVICE_PORT}'
            ),
            "(?m)libmodbus-py certificates certs$": (
                f"libmodbus-py certificates --host {self.address} certs"
            ),
            r"0\.0\.0\.0:502\b": f"{self.address}:{OPEN_PORT}",
            r"\b192\.0\.2\.10\b|\b0\.0\.0\.0\b|\b127\.0\.0\.1\b|\blocalhost\b": self.address,
        }

    @cached_property
    def _ports(self) -> dict[str, str]:
        line, cable = (self.at_end.enter_context(SerialWire()) for _ in range(2))
        self.at_end.enter_context(Server(self.device).background(f"rtu://{line.server}"))
        return {
            "/dev/ttyUSB0": line.client,
            "/dev/ttyUSB1": cable.client,
            "/dev/ttyUSB2": cable.server,
        }
