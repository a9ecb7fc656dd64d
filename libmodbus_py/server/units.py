"""
Units: request frame in, response frame out, if there is one.

Finds the device of a frame, by the rules of its kind of line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from typing import Literal, get_args

from ..device.access import Auditor, Caller
from ..device.device import Device
from ..device.event_log import EventLog
from ..protocol.checks import integer
from ..protocol.errors import GatewayTargetFailedToRespond
from ..protocol.framing import LINE_FEED, Frame
from ..protocol.pdu import Diagnostics
from .faults import Faults
from .service import Channel

# A device, and its notes about a line.
Station = tuple[Device, EventLog]

# The key of a single device that answers every unit; no unit has this number.
EVERY_UNIT = -1

UnknownUnit = Literal["refuse", "silent"]

UNKNOWN_UNIT_POLICIES: tuple[UnknownUnit, ...] = get_args(UnknownUnit)


class Units:
    """
    The devices, by unit.

    `aliases` are further units that a device answers on TCP and UDP; `faults`: those of answers.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        unknown: UnknownUnit = "refuse",
        own_unit: int | None = None,
        on_unauthorized: Callable[[bool], object] = lambda is_said: None,
        auditor: Auditor | None = None,
    ) -> None:
        self.on_unauthorized = on_unauthorized
        self.auditor = auditor
        self.faults: Faults | None = None
        if unknown not in UNKNOWN_UNIT_POLICIES:
            policies = ", ".join(UNKNOWN_UNIT_POLICIES)
            raise ValueError(f"unknown_unit must be one of {policies}, not {unknown!r}")
        self.unknown = unknown
        self.any: Device | None = devices if isinstance(devices, Device) else None
        self.devices: dict[int, Device] = {}
        self.aliases: dict[int, int] = {}
        if self.any is not None:
            if own_unit is not None:
                raise ValueError("own_unit cannot be given where one device answers every unit")
            return
        if not isinstance(devices, Mapping):
            kind = type(devices).__name__
            raise TypeError(f"devices must be a Device or {{unit: Device}}, not {kind}")
        for unit, device in devices.items():
            if not isinstance(device, Device):
                raise TypeError(f"devices[{unit!r}] must be a Device, not {type(device).__name__}")
            self.devices[integer("unit", unit, 0, 255)] = device
        if own_unit is None and len(self.devices) == 1:
            (own_unit,) = self.devices
        if own_unit is not None:
            self._answer_as(integer("own_unit", own_unit, 0, 255))

    def caller(self, unit: int, client: Channel) -> Caller:
        note, auditor = self.on_unauthorized, self.auditor
        return Caller(unit, client.address, None, False, client.role, note, client.holder, auditor)

    def _answer_as(self, unit: int) -> None:
        if unit not in self.devices:
            units = ", ".join(map(str, sorted(self.devices))) or "none"
            raise ValueError(f"own_unit must be a unit that has a device ({units}), not {unit}")
        # Both address the server itself on TCP and UDP (messaging guide, 4.4.2).
        self.aliases = {alias: unit for alias in (0, 255) if alias not in self.devices}


class TcpUnits:
    """
    The units of an endpoint with MBAP headers; `in_c` has the devices whose requests C may answer.
    """

    delimiter = None

    def __init__(self, units: Units) -> None:
        self.change(units)

    def change(self, units: Units) -> None:
        """Replace the units from the next request on."""
        self._shared = units
        self.faults: Faults | None = units.faults
        own = {alias: units.devices[unit] for alias, unit in units.aliases.items()}
        self._devices: dict[int, Device] = own | units.devices
        self._refuses = units.unknown == "refuse"
        self.in_c: list[Device | None] = [
            None if self._is_for_python(unit) else self.device(unit) for unit in range(0x100)
        ]

    def _is_for_python(self, unit: int) -> bool:
        """Return True if C, which reports no write, may answer no request to a unit."""
        has_faults = self.faults is not None and self.faults.concerns(unit)
        return has_faults or self._shared.auditor is not None

    def device(self, unit: int) -> Device | None:
        return self._devices.get(unit, self._shared.any)

    def has(self, unit: int) -> bool:
        return True

    def is_answered(self, frame: Frame) -> bool:
        is_known = self._refuses or self.device(frame.unit) is not None
        return is_known and not frame.pdu[0] & 0x80

    def answer(self, frame: Frame, client: Channel, code: int = 0) -> Frame | None:
        """Execute a request, or refuse it with an exception if there is a `code`."""
        unit, pdu, transaction = frame
        device = self._devices.get(unit, self._shared.any)
        if device is not None:
            caller = self._shared.caller(unit, client)
            response = device.refuse(pdu, code, caller) if code else device.answer(pdu, caller)
        elif pdu[0] & 0x80 or not self._refuses:
            return None
        else:
            response = bytes([pdu[0] | 0x80, code or GatewayTargetFailedToRespond.code])
        return Frame(unit, response, transaction) if response else None

    def note_damage(self, *, overrun: bool) -> None:
        """Do nothing, because TCP has no counters of a line."""

    def note_overheard(self) -> None:
        """Do nothing, because a connection has no other units that answer."""


class SerialLine:
    """The stations of a serial line, which all its connections share."""

    def __init__(self, units: Units) -> None:
        self.stations: dict[int, Station] = {}
        self.change(units)

    def change(self, units: Units) -> None:
        """Replace the units from the next request on; notes about the line stay with their unit."""
        self.shared = units
        devices = units.devices if units.any is None else {EVERY_UNIT: units.any}
        before = {unit: log for unit, (_, log) in self.stations.items()}
        self.stations = {
            unit: (device, before.get(unit) or EventLog(is_serial=True))
            for unit, device in devices.items()
        }


class SerialUnits:
    """
    The units of a serial line, or of one over TCP: silence for other units, broadcasts, and the
    notes of every device about the line.
    """

    def __init__(self, units: Units) -> None:
        self._line = SerialLine(units)
        # The notes that a connection does not share with the others.
        self._own: dict[int, EventLog] | None = None
        self.delimiter: int | None = LINE_FEED

    def change(self, units: Units) -> None:
        """Replace the units from the next request on, on all connections."""
        self._line.change(units)

    def of_connection(self) -> SerialUnits:
        """
        Return the units as one connection has them: with counters and events of the line, but
        listen-only mode and a changed delimiter affect this connection only.
        """
        units = copy(self)
        units._own = {}
        return units

    @property
    def faults(self) -> Faults | None:
        return self._line.shared.faults

    def has(self, unit: int) -> bool:
        return self._line.shared.any is not None or unit in self._line.stations

    def is_answered(self, frame: Frame) -> bool:
        station = self._station(frame.unit)
        if station is None or frame.unit == 0:
            return False
        return not (frame.pdu[0] & 0x80 or station[1].listen_only)

    def answer(self, frame: Frame, client: Channel, code: int = 0) -> Frame | None:
        """As of `TcpUnits`; a broadcast is not refused."""
        self._note_frame()
        caller = self._line.shared.caller(frame.unit, client)._replace(is_broadcast=frame.unit == 0)
        if frame.unit == 0:
            for device, log in self._all():
                device.answer(frame.pdu, caller._replace(log=log))
            return None
        station = self._station(frame.unit, to_change=frame.pdu[0] == Diagnostics.function)
        if station is None:
            return None
        device, log = station
        before, caller = log.delimiter, caller._replace(log=log)
        if code:
            response = device.refuse(frame.pdu, code, caller)
        else:
            response = device.answer(frame.pdu, caller)
        if log.delimiter != before:
            self.delimiter = log.delimiter
        return Frame(frame.unit, response) if response else None

    def note_damage(self, *, overrun: bool) -> None:
        for _, log in self._all():
            log.note_damage(overrun=overrun)

    def note_overheard(self) -> None:
        """Count an answer of another unit on the line."""
        self._note_frame()

    def _note_frame(self) -> None:
        for _, log in self._line.stations.values():
            log.note_frame()

    def _station(self, unit: int, *, to_change: bool = False) -> Station | None:
        if self._line.shared.any is not None:
            unit = EVERY_UNIT
        station = self._line.stations.get(unit)
        if station is None or self._own is None:
            return station
        device, log = station
        if to_change and unit not in self._own:
            self._own[unit] = log.of_connection()
        return device, self._own.get(unit, log)

    def _all(self) -> list[Station]:
        own = self._own or {}
        stations = self._line.stations.items()
        return [(device, own.get(unit, log)) for unit, (device, log) in stations]
