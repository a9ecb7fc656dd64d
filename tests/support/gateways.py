"""What the tests of gateways share: devices behind a line of any kind, and a gateway before it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from libmodbus_py import Client, Device, Fault, Gateway, Route, Server
from tests.simulation.lan import Lan
from tests.support.interop import BAUDRATE, UNIT, make_device
from tests.support.transports import serving


class Passage(NamedTuple):
    """A gateway that serves. `url`: where clients find it."""

    gateway: Gateway
    url: str

    def context(self, unit: int = UNIT, **options: Any) -> Client:
        return Client(self.url, unit=unit, **{"timeout": 5.0, **options})


@contextmanager
def at_one_end(scheme: str, served: Any, lan: Lan | None, name: str) -> Iterator[str]:
    """
    Serve on one kind of line, and yield the URL of a client. `served`: a server or a gateway;
    `lan`: where the line is, in place of the system; a serial one then has this name.
    """
    if lan is not None and scheme in ("rtu", "ascii"):
        url = f"{scheme}:///dev/{name}?baudrate={BAUDRATE}"
        with served.background(url):
            yield url
    else:
        with serving(scheme, served) as url:
            yield url


@contextmanager
def passage(
    front: str = "tcp",
    back: str = "tcp",
    devices: Device | dict[int, Device] | None = None,
    *,
    faults: dict[int | None, list[Fault]] | None = None,
    line_options: str = "timeout=2",
    route: dict[str, Any] | None = None,
    lan: Lan | None = None,
    **options: Any,
) -> Iterator[Passage]:
    """
    Devices on one kind of line, clients on another. `line_options`: of the gateway's client, as in
    URLs; `route`: further arguments of the route; options: of the gateway; `lan`: where all of it
    is, in place of the system.
    """
    units = {UNIT: make_device()} if devices is None else devices
    with at_one_end(back, Server(units, faults=faults), lan, "back") as line:
        line += ("&" if "?" in line else "?") + line_options
        gateway = Gateway([Route(line, **(route or {}))], **options)
        with at_one_end(front, gateway, lan, "front") as url:
            yield Passage(gateway, url)
