"""
An output for InfluxDB: line protocol by HTTP, to a file, or to the standard output.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from ....protocol.mistakes import WrongValue
from ..buffer import MOST_KEPT
from ..config import DeviceConfig
from ..readings import Reading
from .influx_server import InfluxServer
from .line_file import LineFile
from .line_protocol import LineProtocol
from .secret_file import SecretFile

__all__ = ["Influx"]


class _Sink(Protocol):
    """A file or a server, which takes lines."""

    @property
    def name(self) -> str: ...

    async def open(self) -> None: ...

    async def write(self, readings: Sequence[Reading]) -> None: ...

    async def close(self) -> None: ...


class Influx:
    """
    Writes readings in the line protocol of InfluxDB: one line for each poll of a device, with its
    labels as tags and its points as fields. Telegraf and other databases read it, too.

    Args:
        path: the path of a file to append to; "-" for the standard output. This is the default,
            if there is no `url`.
        url: of a server: "http://192.0.2.1:8086", or "https://...".
        database: the database of InfluxDB 1.
        bucket: the bucket of InfluxDB 2; the server needs `token`, and mostly `organization`.
        organization: of the bucket.
        user, password: of InfluxDB 1.
        token: of InfluxDB 2. Passwords and tokens cannot be written in a fleet file.
        ca: a file with the certificate authorities to trust, for https; those of the system
            unless given. It is read again when it changes.
        measurement: the name of the measurement.
        buffer: the most readings that wait; the oldest are dropped beyond.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range, or two that exclude each
            other.

    Source: the HTTP interfaces of InfluxDB 1.x (``/write``) and 2.x (``/api/v2/write``).
    """

    def __init__(
        self,
        path: str | None = None,
        *,
        url: str | None = None,
        database: str | None = None,
        bucket: str | None = None,
        organization: str | None = None,
        user: str | None = None,
        password: str | SecretFile | None = None,
        token: str | SecretFile | None = None,
        ca: str | None = None,
        measurement: str = "modbus",
        buffer: int = MOST_KEPT,
    ) -> None:
        self._protocol = LineProtocol(measurement)
        self.buffer: int = buffer
        of_servers = {
            "database": database,
            "bucket": bucket,
            "organization": organization,
            "user": user,
            "password": password,
            "token": token,
            "ca": ca,
        }
        self._sink: _Sink
        if url is not None:
            if path is not None:
                raise WrongValue("path", "cannot be used with url")
            self._sink = InfluxServer(self._protocol.lines, url, **of_servers)  # type: ignore[arg-type]
            place = "/".join(each for each in (organization, bucket, database) if each)
            used = f"the measurement {measurement!r} in {place!r} of {self.name}"
            self.exclusive: tuple[str, ...] = (used,)
            self.identity: str = f"{self.name} {place} {measurement}"
            return
        needless = [name for name, value in of_servers.items() if value is not None]
        if needless:
            raise WrongValue(needless[0], "can only be used with url")
        self.path: str = "-" if path is None else path
        self._sink = file = LineFile(self.path, self._protocol.format, buffer)
        self.exclusive = file.exclusive
        self.identity = file.identity

    @property
    def name(self) -> str:
        return self._sink.name

    @property
    def is_live(self) -> bool:
        """True if readings of earlier runs are not wanted."""
        return getattr(self._sink, "is_live", False)

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Set the devices of the readings."""
        self._protocol.describe(devices)

    async def open(self) -> None:
        await self._sink.open()

    async def write(self, readings: Sequence[Reading]) -> None:
        await self._sink.write(readings)

    async def close(self) -> None:
        await self._sink.close()
