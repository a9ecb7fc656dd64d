"""
What the tests of gateways share: devices behind a line of any kind, and a gateway before it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

from libmodbus_py import Context, Device, Fault, Gateway, Route, Server
from libmodbus_py.tools.testing.wires import SerialWire
from tests.simulation.stage import Stage
from tests.support.interop import BAUDRATE, UNIT, make_device


class Passage(NamedTuple):
    """
    A gateway that serves.

    Attributes:
        url: where clients find it.
        line: the URL of the line to the devices.
        wire: that line, if it is a serial one.
    """

    gateway: Gateway
    url: str
    line: str
    wire: SerialWire | None

    def context(self, unit: int = UNIT, **options: Any) -> Context:
        return Context.from_url(self.url, unit=unit, **{"timeout": 5.0, **options})


@contextlib.contextmanager
def ends(
    scheme: str, stage: Stage | None = None, name: str = "line"
) -> Iterator[tuple[str, str, SerialWire | None]]:
    """
    Return the two ends of a line: where to listen, and where to find who listens there.

    Args:
        stage: where the line is, in place of the system; then it has this name.
    """
    if stage is not None and scheme in ("rtu", "ascii"):
        url = f"{scheme}:///dev/{name}?baudrate={BAUDRATE}"
        yield url, url, None
    elif scheme in ("rtu", "ascii"):
        with SerialWire() as wire:
            query = f"baudrate={BAUDRATE}"
            yield f"{scheme}://{wire.server}?{query}", f"{scheme}://{wire.client}?{query}", wire
    else:
        yield f"{scheme}://127.0.0.1:0", "", None


@contextlib.contextmanager
def passage(
    front: str = "tcp",
    back: str = "tcp",
    devices: Device | dict[int, Device] | None = None,
    *,
    faults: dict[int | None, list[Fault]] | None = None,
    line_options: str = "timeout=2",
    route: dict[str, Any] | None = None,
    stage: Stage | None = None,
    **options: Any,
) -> Iterator[Passage]:
    """
    Devices on one kind of line, clients on another.

    Args:
        line_options: of the gateway's client, as in URLs.
        route: further arguments of the route; options: of the gateway.
        stage: where all of it is, in place of the system.
    """
    given = {UNIT: make_device()} if devices is None else devices
    with contextlib.ExitStack() as stack:
        here, there, wire = stack.enter_context(ends(back, stage, "back"))
        running = stack.enter_context(Server(given, faults).background(here))
        line = there or running.urls[0]
        line += ("&" if "?" in line else "?") + line_options
        gateway = Gateway([Route(line, **(route or {}))], **options)
        here, there, _ = stack.enter_context(ends(front, stage, "front"))
        running = stack.enter_context(gateway.background(here))
        yield Passage(gateway, there or running.urls[0], line, wire)
