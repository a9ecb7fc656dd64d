"""The server of a program: the devices of many units, and faults in their responses."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..binding.library import replier
from ..device.device import Device
from ..ports.endpoint import Endpoint
from ..ports.trace import OnTraced
from ..protocol.mistakes import named_arguments
from .faults import Faults, FaultsByUnit, FaultSwitch, ServerFault
from .framed import SessionSettings
from .limits import Limits, ServerStatistics
from .service import Later, MakeSession, Service, explained
from .serving import Serving
from .sessions import ByChunk, ByFrame, Singles
from .units import SerialUnits, TcpUnits, Units, UnknownUnit

if TYPE_CHECKING:
    from ..security.security import Security
    from .audit import Audit, OnAudited


@named_arguments
class Server(Serving):
    """
    A server that answers the requests of any number of clients from devices.

    On serial lines, and with RTU or ASCII frames over TCP, a request to a unit without a device
    gets no response, and unit 0 is a broadcast: every device executes writes, and none responds.

    Args:
        devices: ``{unit 0..255: device}``, or one device that answers every unit.
        faults: ``{unit 0..255: faults}``, faults in the responses of a unit, such as `Fault`;
            None as the unit is every unit.
        limits: limits of connections and requests; None for the defaults of `Limits`.
        unknown_unit: what a request to a unit without a device gets on TCP and UDP: "refuse",
            exception 11; "silent", no response.
        own_unit: the unit whose device represents the server itself: on TCP and UDP, it also
            answers units 0 and 255, unless they have devices of their own. A single device
            always does. None for no such unit.
        security: the certificates of the server and of trusted clients, for tls; URLs may contain
            them instead.
        trace: called in the server's loop with a `TracedFrame` for every ADU received and sent; the
            logger ``libmodbus_py.wire`` gets the same at DEBUG. Whether tracing is on is
            checked when a connection is made, or a port opened. If the function fails or takes
            long, this is logged once, and requests are not affected; SystemExit and
            KeyboardInterrupt end the server.
        audit: called with an `AuditEvent` for each write, and for each request and connection
            that is refused; an `Audit` can refuse writes while the function fails. With it,
            Modbus/TCP is not answered in C.
        state: the path of a file that keeps the values of the devices. They are loaded when the
            server starts, and a thread writes those that differ from the first ones at most 0.5 s
            after a change (later only where a write takes over 0.08 s), and at the end, so that
            no client waits for the disk.

    Attributes:
        statistics: counters of all endpoints, kept up to date.
        fault_switch: switches more faults on and off while the server runs; shared by all its
            users.

    Raises:
        TypeError, ValueError: an argument is wrong.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        *,
        faults: Mapping[int | None, Iterable[ServerFault]] | None = None,
        limits: Limits | None = None,
        unknown_unit: UnknownUnit = "refuse",
        own_unit: int | None = None,
        security: Security | None = None,
        trace: OnTraced | None = None,
        audit: Audit | OnAudited | None = None,
        state: str | os.PathLike[str] | None = None,
    ) -> None:
        super().__init__(limits, security, trace, audit)
        self._state: contextlib.AbstractContextManager[object] = contextlib.nullcontext()
        if state is not None:
            from .state_file import StateFile  # which few programs need

            self._state = StateFile(os.fspath(state), lambda: self._devices)
        self._unknown_unit: UnknownUnit = unknown_unit
        self._own_unit = own_unit
        self._answering_now: list[tuple[asyncio.AbstractEventLoop, Devices]] = []
        self._faults: Faults | None = None
        self.fault_switch: FaultSwitch = FaultSwitch(
            lambda faults: self._serve(self._devices, faults)
        )
        self.replace(devices, faults=faults)

    @property
    def devices(self) -> Device | Mapping[int, Device]:
        """The devices, as passed, or as set by `replace`."""
        return self._devices

    @property
    def faults(self) -> Mapping[int | None, list[ServerFault]]:
        """The faults that were passed, or set by `replace`."""
        return self._fault_lists

    def replace(
        self,
        devices: Device | Mapping[int, Device],
        *,
        faults: Mapping[int | None, Iterable[ServerFault]] | None = None,
    ) -> None:
        """
        Replace devices and faults. May be called from any thread, even while the server runs.

        Connections stay open. If it is called in the server's loop, the change applies from the
        next request on; if it is called from another thread, once the requests already read are
        answered. Responses that a fault delays are still sent. `own_unit` and all other arguments
        stay as they are. Faults that are equal to previous ones go on counting, the counters and
        the event log of a serial line (functions 8, 11 and 12) stay with their unit, and faults
        that `fault_switch` has switched on stay on.

        Args:
            devices, faults: as for `Server`; None for no faults.

        Raises:
            TypeError, ValueError: as for `Server`; nothing has changed.
        """
        if faults is not None and not isinstance(faults, Mapping):
            given_type = type(faults).__name__
            raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {given_type}")
        lists = {unit: _listed(unit, unit_faults) for unit, unit_faults in (faults or {}).items()}
        with self.fault_switch.giving(lists) as faults_on:
            self._serve(devices, faults_on)
        self._fault_lists = lists

    def check_devices(self, devices: Device | Mapping[int, Device]) -> None:
        """Raise TypeError or ValueError if `replace` would do so for these devices."""
        self._units_of(devices)

    def _serve(self, devices: Device | Mapping[int, Device], faults: FaultsByUnit) -> None:
        units = self._units_of(devices)
        self._faults = Faults(faults, self._faults, units.aliases)
        units.faults = self._faults or None
        self._devices, self._units = devices, units
        for loop, answering in list(self._answering_now):  # in each, between two requests
            if loop is _running_loop():
                answering.change(units)
            else:
                with contextlib.suppress(RuntimeError):  # the loop has just ended
                    loop.call_soon_threadsafe(self._renew, answering)

    def _units_of(self, devices: Device | Mapping[int, Device]) -> Units:
        """Return devices as the units of this server, or raise TypeError or ValueError."""
        return Units(
            devices, self._unknown_unit, self._own_unit, self._note_unauthorized, self._auditor
        )

    def _renew(self, answering: Devices) -> None:
        answering.change(self._units)

    @contextlib.asynccontextmanager
    async def _answering(self, endpoints: list[Endpoint]) -> AsyncIterator[Service]:
        with explained("cannot serve"):
            replier()  # creates its descriptors, before clients take the last ones
        answering = Devices(self._units)
        now = asyncio.get_running_loop(), answering
        with self._state:
            self._answering_now.append(now)
            try:
                self._renew(answering)  # another thread may have replaced them in between
                yield answering
            finally:
                self._answering_now.remove(now)

    def _note_unauthorized(self, is_said: bool) -> None:
        self.statistics.unauthorized += is_said


class Devices:
    """The service of devices: each request is answered at once. See `Service`."""

    def __init__(self, units: Units) -> None:
        self._units = units
        self._of_endpoints: list[TcpUnits | SerialUnits] = []

    def change(self, units: Units) -> None:
        """Replace the units from the next request on, on all connections; in their loop."""
        self._units = units
        for endpoint_units in self._of_endpoints:
            endpoint_units.change(units)

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        settings = SessionSettings(endpoint, statistics, has_turns=later is not None)
        if not endpoint.has_transactions:
            line = SerialUnits(self._units)
            self._of_endpoints.append(line)
            if endpoint.is_serial:
                return lambda channel: ByFrame(settings, line, channel)
            return lambda channel: ByFrame(settings, line.of_connection(), channel)
        own = TcpUnits(self._units)
        self._of_endpoints.append(own)
        if later is None:
            return lambda channel: ByFrame(settings, own, channel)
        singles = Singles(own, statistics, later)
        return lambda channel: ByChunk(settings, own, channel, singles)


def _listed(unit: int | None, faults: object) -> list[Any]:
    if isinstance(faults, str) or not isinstance(faults, Iterable):
        kind = type(faults).__name__
        raise TypeError(f"faults[{unit!r}] must be a list of faults, not {kind}")
    return list(faults)


def _running_loop() -> asyncio.AbstractEventLoop | None:
    with contextlib.suppress(RuntimeError):
        return asyncio.get_running_loop()
    return None
