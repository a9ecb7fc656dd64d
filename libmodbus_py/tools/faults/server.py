"""
The server of a program: devices, and faults in their responses.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from ...device.device import Device
from ...ports.trace import OnTraced
from ...protocol.mistakes import named_arguments
from ...server.limits import Limits
from ...server.server import DeviceServer
from ...server.units import UnknownUnit
from .answers import Faults
from .fault import Fault
from .switch import FaultsByUnit, FaultSwitch

if TYPE_CHECKING:
    from ...security.security import Security
    from ...server.audit import Audit, OnAudited

__all__ = ["Server"]


@named_arguments
class Server(DeviceServer):
    """
    A server that answers the requests of any number of clients from devices.

    On serial lines, and with RTU or ASCII frames over TCP, a request to a unit without a device
    gets no response, and unit 0 is a broadcast: every device executes writes, and none responds.

    Args:
        devices: ``{unit 0..255: device}``, or one device that answers every unit.
        faults: ``{unit 0..255: faults}``, faults in the responses of a unit;
            None as the unit is every unit.
        limits: limits of connections and requests; None for the defaults of `Limits`.
        unknown_unit: what a request to a unit without a device gets on TCP and UDP: "refuse",
            exception 11; "silent", no response.
        own_unit: the unit whose device represents the server itself: on TCP and UDP, it also
            answers units 0 and 255, unless they have devices of their own. A single device
            always does. None for no such unit.
        security: the certificates of the server and of trusted clients, for tls; URLs may contain
            them instead.
        trace: called in the server's loop with a `Traced` for every ADU received and sent; the
            logger ``libmodbus_py.wire`` gets the same at DEBUG. Whether tracing is on is
            checked when a connection is made, or a port opened. If the function fails or takes
            long, this is logged once, and requests are not affected; SystemExit and
            KeyboardInterrupt end the server.
        audit: called with an `AuditEvent` for each write, and for each request and connection
            that is refused; an `Audit` can refuse writes while the function fails. With it,
            Modbus/TCP is not answered in C.

    Attributes:
        statistics: counters of all endpoints, kept up to date.
        devices, faults: as passed, or as set by `replace`.
        fault_switch: switches more faults on and off while the server runs; shared by all its
            users.

    Raises:
        TypeError, ValueError: an argument is wrong.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
        limits: Limits | None = None,
        unknown_unit: UnknownUnit = "refuse",
        own_unit: int | None = None,
        security: Security | None = None,
        trace: OnTraced | None = None,
        audit: Audit | OnAudited | None = None,
    ) -> None:
        super().__init__(limits, unknown_unit, own_unit, security, trace, audit)
        self._counted: Faults | None = None
        self.fault_switch: FaultSwitch = FaultSwitch(self._change_faults)
        self._put(devices, faults)

    def replace(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
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
        self._put(devices, faults)

    def _put(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None,
    ) -> None:
        given = {unit: list(each) for unit, each in _listed(faults).items()}
        with self.fault_switch.giving(given) as switched_on:
            self._serve(devices, switched_on)
        self.faults: Mapping[int | None, list[Fault]] = given

    def _change_faults(self, faults: FaultsByUnit) -> None:
        self._serve(self.devices, faults)

    def _serve(self, devices: Device | Mapping[int, Device], faults: FaultsByUnit) -> None:
        units = self.units_of(devices)
        self._counted = Faults(faults, self._counted, units.aliases)
        units.interceptor = self._counted or None
        self.devices: Device | Mapping[int, Device] = devices
        self.serve_units(units)


def _listed(faults: object) -> Mapping[int | None, Iterable[Fault]]:
    if faults is None:
        return {}
    if not isinstance(faults, Mapping):
        given = type(faults).__name__
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {given}")
    return faults
