"""
A server of InfluxDB, which takes lines by HTTP. It needs httpx (the extra ``influx``).
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import ssl
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

from ....protocol.mistakes import WrongType, WrongValue
from ....protocol.plain import without_controls
from ....security.renewed import Renewed
from ...server_url import url_without_login
from ...tasks import finish
from ..readings import Reading
from .output import OutputError, ReadingsRefused
from .secret_file import SecretFile, text_of
from .trust import trust

if TYPE_CHECKING:
    import httpx

__all__ = ["InfluxServer"]

PORTS = {"http": 80, "https": 443}
"""Scheme -> port of a URL without one."""

# Seconds for a server to take a batch, whatever it does meanwhile.
TIMEOUT = 30.0

# The most that is read of an answer, in bytes, and that is shown of it, in characters.
LONGEST_ANSWER, LONGEST_SHOWN = 4096, 200

# The longest time that a server may demand before the next attempt, in seconds.
LONGEST_DEMAND = 300.0

ACCEPTED = 204

REFUSED = (400, 413, 422)
"""Statuses after which the same lines would be refused again."""

BUSY = (429, 503)


class InfluxServer:
    """
    Sends readings to a server.

    Redirections are not followed, because they would lead the credentials elsewhere.

    Args:
        encode: returns readings as lines.
        url: of the server.
        database, bucket, organization, user, password, token, ca: as for `Influx`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(
        self,
        encode: Callable[[Sequence[Reading]], bytes],
        url: str,
        *,
        database: str | None = None,
        bucket: str | None = None,
        organization: str | None = None,
        user: str | None = None,
        password: str | SecretFile | None = None,
        token: str | SecretFile | None = None,
        ca: str | None = None,
    ) -> None:
        server = url_without_login(url, PORTS, "http://192.0.2.1:8086", may_have_path=True)
        base, is_secure = url.rstrip("/"), server.scheme == "https"
        self.name: str = f"influx {server.place}"
        given = {"database": database, "bucket": bucket, "organization": organization}
        for key, value in {**given, "user": user}.items():
            if value is not None and (not isinstance(value, str) or not value):
                raise WrongType(key, f"must be text, not {value!r}")
        _check(given, user, password, token)
        if ca is not None and not is_secure:
            raise WrongValue("ca", "can only be used with https://")
        if database is not None:
            self._url, query = f"{base}/write", {"db": database}
        else:
            self._url, query = f"{base}/api/v2/write", {"bucket": bucket or ""}
            if organization is not None:
                query["org"] = organization
        self._query = {**query, "precision": "ns"}
        self._encode = encode
        self._user, self._secret = user, token if token is not None else password
        self._trusted: Renewed[ssl.SSLContext] | None = None
        self._trust = partial(trust, ca)
        self._is_secure = is_secure
        self._client: httpx.AsyncClient | None = None
        self._not_before = 0.0

    async def open(self) -> None:
        try:
            import httpx
        except ImportError:
            raise OutputError("InfluxDB needs httpx: pip install 'libmodbus-py[influx]'") from None
        # The server has demanded this pause.
        await asyncio.sleep(max(0.0, self._not_before - time.monotonic()))
        context = await asyncio.to_thread(self._context) if self._is_secure else False
        self._client = httpx.AsyncClient(verify=context, timeout=TIMEOUT)

    def _context(self) -> ssl.SSLContext:
        if self._trusted is None:
            self._trusted = Renewed(self._trust)
            return self._trusted.value
        return self._trusted.fresh()

    async def write(self, readings: Sequence[Reading]) -> None:
        lines = self._encode(readings)
        if not lines:
            return
        secret = await asyncio.to_thread(text_of, self._secret)
        try:
            async with asyncio.timeout(TIMEOUT):
                with _as_os_error():
                    status, demand, answer = await self._post(lines, secret)
        except TimeoutError:
            raise TimeoutError(f"the server did not answer in {TIMEOUT:g} s") from None
        if status == ACCEPTED:
            return
        told = f"{status} {_shown(answer, self._user, secret)}".rstrip()
        if status < 300:
            told = f"the server answered {status} to a write, InfluxDB 204: is this its URL?"
        if status in REFUSED:
            raise ReadingsRefused(told)
        if status in BUSY:
            self._not_before = time.monotonic() + demand
        raise OSError(told)

    async def _post(self, lines: bytes, secret: str | None) -> tuple[int, float, bytes]:
        """Return the status of the answer, the pause that it demands, and what it says."""
        client, headers = self._client, {"Content-Type": "text/plain; charset=utf-8"}
        assert client is not None
        if secret is not None and self._user is None:
            headers["Authorization"] = f"Token {secret}"
        login = None if self._user is None else (self._user, secret or "")
        sending = client.stream(
            "POST", self._url, params=self._query, content=lines, headers=headers, auth=login
        )
        async with sending as answer:
            told = b""
            async for piece in answer.aiter_raw():
                told += piece[:LONGEST_ANSWER]
                if len(told) >= LONGEST_ANSWER:
                    break
            return answer.status_code, _seconds(answer.headers.get("retry-after")), told

    async def close(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            await finish(client.aclose(), 1.0)


@contextlib.contextmanager
def _as_os_error() -> Iterator[None]:
    """
    Raise the errors of httpx as those of an output.

    Raises:
        ConnectionError: the connection was lost while lines were sent, perhaps due to them.
        OSError: another error.
    """
    import httpx

    try:
        yield
    except (httpx.ReadError, httpx.WriteError, httpx.RemoteProtocolError) as error:
        raise ConnectionResetError(_reason(error)) from None
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError) as error:
        raise OSError(_reason(error)) from None


def _reason(error: Exception) -> str:
    return without_controls(str(error))[:LONGEST_SHOWN] or type(error).__name__


def _shown(answer: bytes, user: str | None, secret: str | None) -> str:
    """Return the text of an answer without credentials that the server repeats."""
    text = answer.decode(errors="replace")
    if secret:
        basic = base64.b64encode(f"{user}:{secret}".encode()).decode()
        text = text.replace(basic, "***").replace(secret, "***")
    return " ".join(without_controls(text).split())[:LONGEST_SHOWN]


def _seconds(demand: str | None) -> float:
    """Return the seconds of a header Retry-After; 0 if it is none, or a date."""
    if demand is None or not demand.isascii() or not demand.isdigit():
        return 0.0
    return min(float(demand[:9]), LONGEST_DEMAND)


def _check(
    given: dict[str, str | None],
    user: str | None,
    password: str | SecretFile | None,
    token: str | SecretFile | None,
) -> None:
    """Check which arguments occur together."""
    if (given["database"] is None) == (given["bucket"] is None):
        raise WrongValue.about("url", "needs either database (InfluxDB 1) or bucket (InfluxDB 2)")
    if given["organization"] is not None and given["bucket"] is None:
        raise WrongValue("organization", "can only be used with bucket")
    if (user is None) != (password is None):
        raise WrongValue("user", "and password must be given together")
    if user is not None and token is not None:
        raise WrongValue("token", "cannot be used with user")
