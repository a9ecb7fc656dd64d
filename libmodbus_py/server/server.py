"""
The server: many clients, many units, many endpoints, in one asyncio loop.

An endpoint (`tcp`, `udp`, `serial`) takes bytes to a session (`by_chunk`, `by_frame`),
which takes requests to the device of their unit, and the answers go back in order of
arrival. Nobody waits for anybody.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Iterable, Mapping

from ..device.device import Device
from ..device.reply import replier
from ..ports.endpoint import Endpoint
from ..security.security import Security
from .devices import Devices
from .faults import Fault, Faults
from .limits import Limits
from .service import Service
from .serving import Running, Serving
from .units import Units, UnknownUnit

__all__ = ["Running", "Server"]


class Server(Serving):
    """
    Serves devices to any number of clients.

    On serial lines, and such lines over TCP, a unit without a device is silent, and unit 0
    is a broadcast: writes go to every device, nobody answers.

    Args:
        devices: ``{unit 0..255: device}``, or one device that answers every unit.
        faults: ``{unit 0..255: faults}``, what goes wrong with the answers of a unit;
            None is every unit.
        limits: what clients may cost; None for the defaults of `Limits`.
        unknown_unit: what a unit without a device gets on TCP and UDP: "refuse", exception
            11; "silent", nothing.
        own_unit: which of several devices the server itself is: on TCP and UDP it answers
            units 0 and 255, too, unless they have devices of their own. One device alone
            always does. None: none of them.
        security: who it is and whom it trusts, for tls; the URLs may say it instead.

    Attributes:
        statistics: what happened at all endpoints, kept up to date.

    Raises:
        TypeError, ValueError: an argument is something else.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
        limits: Limits | None = None,
        unknown_unit: UnknownUnit = "refuse",
        own_unit: int | None = None,
        security: Security | None = None,
    ) -> None:
        super().__init__(limits, security)
        made = Faults({} if faults is None else faults)
        self._units = Units(devices, made, unknown_unit, own_unit, self._note_unauthorized)

    @contextlib.asynccontextmanager
    async def _answering(self, endpoints: list[Endpoint]) -> AsyncIterator[Service]:
        replier()  # its descriptors, before clients take the last ones
        yield Devices(self._units)

    def _note_unauthorized(self) -> None:
        self.statistics.unauthorized += 1
