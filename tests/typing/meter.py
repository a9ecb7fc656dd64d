"""
The points of meter, written by libmodbus-py map class.
"""
# fmt: off

from __future__ import annotations

from collections.abc import Coroutine
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    Literal,
    TypedDict,
    TypeVar,
    Unpack,
    overload,
)

from libmodbus_py import Point, RegisterMap
from libmodbus_py.bound import MapBinding

if TYPE_CHECKING:
    from libmodbus_py import AsyncClient, Client

ClientT = TypeVar("ClientT", "Client", "AsyncClient")

MeterName = Literal[
    'voltage',
    'energy_total',
    'setpoint',
    'serial_number',
    'run',
]


class MeterValues(TypedDict, total=False):
    """Values that can be written."""

    setpoint: float
    run: bool
    reset: bool


MAP = RegisterMap(
    [
        Point(
            name='voltage',
            table='input_registers',
            address=0,
            type='uint16',
            scale=0.1,
            units='V',
            access='read',
            description='phase to neutral',
        ),
        Point(
            name='energy total',
            table='input_registers',
            address=4,
            type='uint32',
            units='kWh',
            access='read',
        ),
        Point(
            name='setpoint',
            table='holding_registers',
            address=0,
            type='uint16',
            scale=0.1,
            units='°C',
            access='read_write',
            minimum=5,
            maximum=30,
        ),
        Point(
            name='serial number',
            table='holding_registers',
            address=10,
            type='string:8',
            access='read',
        ),
        Point(
            name='run',
            table='coils',
            address=0,
            access='read_write',
        ),
        Point(
            name='reset',
            table='coils',
            address=1,
            access='write',
        ),
    ]
)


class _MeterRequests(MapBinding, Generic[ClientT]):
    def __init__(self, client: ClientT, **options: Any) -> None:
        super().__init__(client, MAP, **options)

    @overload
    def read(
        self: _MeterRequests[Client], *attributes: MeterName
    ) -> None: ...
    @overload
    def read(
        self: _MeterRequests[AsyncClient], *attributes: MeterName
    ) -> Coroutine[Any, Any, None]: ...
    def read(self, *attributes: Any) -> Any:
        """Read points, all that can be read unless attributes are named."""
        return self._read(attributes)

    @overload
    def write(
        self: _MeterRequests[Client], **values: Unpack[MeterValues]
    ) -> None: ...
    @overload
    def write(
        self: _MeterRequests[AsyncClient], **values: Unpack[MeterValues]
    ) -> Coroutine[Any, Any, None]: ...
    def write(self, **values: Any) -> Any:
        """Write values; all are checked before the first byte is sent."""
        return self._write(values)


class Meter(_MeterRequests[ClientT]):
    """Values of the last read(); each is written with write()."""

    @property
    def voltage(self) -> float:
        """
        voltage: uint16, V, read-only.

        phase to neutral
        """
        value: float = self._certain('voltage')
        return value

    @property
    def energy_total(self) -> int:
        """
        energy total: uint32, kWh, read-only.
        """
        value: int = self._certain('energy total')
        return value

    @property
    def setpoint(self) -> float:
        """
        setpoint: uint16, °C, 5..30.
        """
        value: float = self._certain('setpoint')
        return value

    @property
    def serial_number(self) -> str:
        """
        serial number: string:8, read-only.
        """
        value: str = self._certain('serial number')
        return value

    @property
    def run(self) -> bool:
        """
        run: bit.
        """
        value: bool = self._certain('run')
        return value
