"""
An output for InfluxDB: line protocol by HTTP, to a file, or to the standard output. HTTP needs
httpx (the extra ``influx``).
"""

from __future__ import annotations

import asyncio
import base64
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from ....protocol.mistakes import WrongType, WrongValue
from ....protocol.plain import plain, without_controls
from ....version import what_is_missing
from ...other_servers import SecretFile, Trust, server_url, text_of
from ...tasks import finish
from ..config import DeviceConfig
from ..readings import MOST_KEPT, Reading
from .line_file import Format, LineFile
from .output import Output, OutputError, ReadingsRefused

if TYPE_CHECKING:
    import httpx

PORTS = {"http": 80, "https": 443}  # scheme -> port of a URL without one
LOGIN = "user and password_file, or token_file"  # what a login is written in
TIMEOUT_S = 30.0  # seconds for a server to take a batch, whatever it does meanwhile

# What is read of an answer, and what is shown of it.
LONGEST_ANSWER_BYTES, LONGEST_SHOWN_CHARACTERS = 4096, 200

# The status after a write, and those after which the same lines would be refused again.
ACCEPTED_STATUS, REFUSED = 204, (400, 413, 422)


class Influx(Output):
    """
    Writes readings in the line protocol of InfluxDB, which Telegraf and other databases read, too.

    The arguments are the keys of fleet files: `path` for a file or "-", which is the default, or
    `url` of a server, with `database` for InfluxDB 1 and `bucket` for InfluxDB 2.

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
        self._file: LineFile | None = None
        texts = {"database": database, "bucket": bucket, "organization": organization, "user": user}
        if url is None:
            for name, value in {**texts, "password": password, "token": token, "ca": ca}.items():
                if value is not None:
                    raise WrongValue(name, "can only be used with url")
            begin = f"{self._protocol.measurement},".encode()
            form = Format("influx", self._protocol.lines, begin)
            self._file = file = LineFile("-" if path is None else path, form, buffer)
            self.path: str = file.path
            self.name: str = file.name
            self.is_live: bool = file.is_live
            self.exclusive: tuple[str, ...] = file.exclusive
            self._identity = file.identity
            return
        if path is not None:
            raise WrongValue("path", "cannot be used with url")
        server = server_url(
            "url", url, PORTS, example="http://192.0.2.1:8086", login=LOGIN, may_have_path=True
        )
        if ca is not None and server.scheme != "https":
            raise WrongValue("ca", "can only be used with https://")
        _check(texts, password, token)
        self._url = f"{url.rstrip('/')}{'/write' if database else '/api/v2/write'}"
        query = {"db": database, "bucket": bucket, "org": organization, "precision": "ns"}
        self._query = {key: value for key, value in query.items() if value}
        self._user = user
        self._secret = password if token is None else token
        self._trust = Trust(ca) if server.scheme == "https" else None
        self._client: httpx.AsyncClient | None = None
        self.name = f"influx {server.place}"
        place = "/".join(part for part in (organization, bucket, database) if part)
        self.exclusive = (f"the measurement {measurement!r} in {place!r} of {self.name}",)
        self._identity = f"{self.name} {place} {measurement}"

    @property
    def identity(self) -> str:
        return self._identity

    def describe_devices(self, devices: Mapping[str, DeviceConfig]) -> None:
        self._protocol.describe(devices)

    async def open_output(self) -> None:
        if self._file is not None:
            await self._file.open_output()
            return
        try:
            import httpx
        except ImportError:
            raise OutputError(what_is_missing("InfluxDB", "influx")) from None
        context = await self._trust.context() if self._trust else False
        self._client = httpx.AsyncClient(verify=context, timeout=TIMEOUT_S)

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        if self._file is not None:
            await self._file.write_readings(readings)
        elif lines := self._protocol.lines(readings):
            await self._send(lines)

    async def close_output(self) -> None:
        if self._file is not None:
            await self._file.close_output()
        elif self._client is not None:
            client, self._client = self._client, None
            await finish(client.aclose())

    async def _send(self, lines: bytes) -> None:
        import httpx

        secret = await text_of(self._secret)
        try:
            async with asyncio.timeout(TIMEOUT_S):
                status, answer = await self._post(lines, secret)
        except TimeoutError:
            raise TimeoutError(f"the server did not answer in {TIMEOUT_S:g} s") from None
        except (httpx.ReadError, httpx.WriteError, httpx.RemoteProtocolError) as error:
            raise ConnectionResetError(_reason(error)) from None  # while lines were sent
        except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError) as error:
            raise OSError(_reason(error)) from None
        if status == ACCEPTED_STATUS:
            return
        if status < 300:
            message = f"the server answered {status} to a write, InfluxDB 204: is this its URL?"
            raise OSError(message)
        message = f"{status} {_shown(answer, self._user, secret)}".rstrip()
        raise (ReadingsRefused if status in REFUSED else OSError)(message)

    async def _post(self, lines: bytes, secret: str | None) -> tuple[int, bytes]:
        """Return the status of the answer, and what it says; redirections are not followed."""
        client, headers = self._client, {"Content-Type": "text/plain; charset=utf-8"}
        assert client is not None
        if secret is not None and self._user is None:
            headers["Authorization"] = f"Token {secret}"
        login = None if self._user is None else (self._user, secret or "")
        sending = client.stream(
            "POST", self._url, params=self._query, content=lines, headers=headers, auth=login
        )
        async with sending as answer:
            begin = b""
            async for chunk in answer.aiter_raw():
                begin += chunk[:LONGEST_ANSWER_BYTES]
                if len(begin) >= LONGEST_ANSWER_BYTES:
                    break
            return answer.status_code, begin


def _check(
    texts: Mapping[str, str | None],
    password: str | SecretFile | None,
    token: str | SecretFile | None,
) -> None:
    """Check which arguments occur together."""
    for key, value in texts.items():
        if value is not None and (not isinstance(value, str) or not value):
            raise WrongType(key, f"must be text, not {value!r}")
    if (texts["database"] is None) == (texts["bucket"] is None):
        raise WrongValue.about("url", "needs either database (InfluxDB 1) or bucket (InfluxDB 2)")
    if texts["organization"] is not None and texts["bucket"] is None:
        raise WrongValue("organization", "can only be used with bucket")
    if (texts["user"] is None) != (password is None):
        raise WrongValue("user", "and password must be given together")
    if texts["user"] is not None and token is not None:
        raise WrongValue("token", "cannot be used with user")


def _reason(error: Exception) -> str:
    return without_controls(str(error))[:LONGEST_SHOWN_CHARACTERS] or type(error).__name__


def _shown(answer: bytes, user: str | None, secret: str | None) -> str:
    """Return the text of an answer without credentials that the server repeats."""
    text = answer.decode(errors="replace")
    if secret:
        basic = base64.b64encode(f"{user}:{secret}".encode()).decode()
        # A server may repeat them with other spaces: only what lies between these is compared.
        for password in (basic, secret):
            words = [re.escape(word) for word in password.split()]
            text = re.sub(r"\s+".join(words), "***", text) if words else text
    return " ".join(without_controls(text).split())[:LONGEST_SHOWN_CHARACTERS]


_MEASUREMENT = re.compile(r"[^_#\\][^\\]{0,199}")

_KEY = re.compile(r"([,= ])")

RESERVED = ("time", "_time", "_measurement", "_field", "_value", "_start", "_stop")
"""Keys that InfluxDB 1 and 2 use themselves: points and labels of these names get a "_" behind."""


class LineProtocol:
    """
    Writes a line for each poll of a device, such as
    ``modbus,device=north,site=Halle voltage=230.5,power=1200 1700000000000000000``.

    A field has one type for good in InfluxDB: numbers are floats, and a point with named states is
    text, also where a number has no name.
    """

    def __init__(self, measurement: object) -> None:
        if not isinstance(measurement, str):
            raise WrongType("measurement", f"must be text, not {type(measurement).__name__}")
        if not _MEASUREMENT.fullmatch(measurement) or not measurement.isprintable():
            rule = "1 to 200 printable characters without \\, the first neither _ nor #"
            raise WrongValue("measurement", f"must be {rule}, not {measurement[:50]!r}")
        self.measurement: str = re.sub("([, ])", r"\\\1", measurement)
        # Device -> its points whose values are text, also of devices that were removed.
        self._texts: dict[str, frozenset[str]] = {}

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        self._texts |= {
            name: frozenset(point for point in config.map if config.map[point].states is not None)
            for name, config in devices.items()
        }

    def lines(self, readings: Iterable[Reading]) -> bytes:
        """Return the lines of readings, in UTF-8; times are in nanoseconds."""
        return "".join(
            f"{self._head(poll[0].device, poll[0].labels)} {','.join(fields)}"
            f" {round(poll[0].time * 1e6) * 1000}\n"
            for poll in [list(group) for _, group in groupby(readings, attrgetter("poll"))]
            if (fields := [field for reading in poll for field in self._fields(reading)])
        ).encode()

    def _head(self, device: str, labels: Mapping[str, str]) -> str:
        tags = {"device": device, **labels}
        # InfluxDB recommends tags in order; a tag without a value is not a tag.
        parts = [f"{_key(name)}={_spelled(tags[name])}" for name in sorted(tags) if tags[name]]
        return ",".join((self.measurement, *parts))

    def _fields(self, reading: Reading) -> Iterator[str]:
        name = reading.name
        if reading.value is None:
            yield f"{_key(f'{name}.quality')}={_text(reading.quality)}"
        elif name in self._texts.get(reading.device, ()):
            yield f"{_key(name)}={_text(str(reading.value))}"
        else:
            yield from _values(name, reading.value)
        if reading.reason:
            yield f"{_key(f'{name}.reason')}={_text(reading.reason)}"


def _values(name: str, value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _values(f"{name}.{key}", part)
    elif isinstance(value, list | tuple):
        for at, part in enumerate(value):
            yield from _values(f"{name}.{at}", part)
    elif value is not None and not (isinstance(value, float) and not math.isfinite(value)):
        yield f"{_key(name)}={_field(value)}"


def _field(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, int | float) else _text(str(plain(value)))


def _text(text: str) -> str:
    """Return text as a field, in one line."""
    line = without_controls(text).replace("\n", "\\x0a").replace("\\", "\\\\")
    return '"' + line.replace('"', '\\"') + '"'


def _key(name: str) -> str:
    return _spelled(f"{name}_" if name in RESERVED else name)


def _spelled(name: str) -> str:
    # A backslash cannot be escaped, and would escape the character behind it.
    line = without_controls(name).replace("\n", "%0A").replace("\\", "%5C")
    return _KEY.sub(r"\\\1", line)
