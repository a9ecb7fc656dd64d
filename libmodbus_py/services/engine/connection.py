"""
A connection to NATS, and its errors in one line each. Needs nats-py (the extra ``nats``).

Credentials come from environment variables, as for the tools of NATS; other users of the machine
cannot read them: NATS_USER, NATS_PASSWORD, NATS_TOKEN; NATS_CREDS and NATS_NKEY, files; NATS_CA,
NATS_CERT and NATS_KEY, files for TLS. The files are read again for each connection, and on SIGHUP.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
from collections import UserString
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from ...security.certificates import in_words
from ...security.security import RenewedValue, read_secret
from ...version import what_is_missing
from ..other_servers import server_url
from ..tasks import finish

if TYPE_CHECKING:
    from nats.aio.client import Client

# The oldest version of nats-server with the features that watches need.
OLDEST = (2, 9)

# Scheme -> port of a URL without one.
PORTS = {"nats": 4222, "tls": 4222}

# Seconds before connecting to a server times out; and between attempts to reconnect.
TIMEOUT = 3.0
PAUSE = 0.25

# What a login is written in.
LOGIN = "the variables NATS_USER and NATS_PASSWORD, or NATS_CREDS, which names a file"

# Options of nats-py, whose types want whole seconds.
TIMES: dict[str, Any] = {
    "connect_timeout": TIMEOUT,
    "reconnect_time_wait": PAUSE,
    "max_reconnect_attempts": 1,
    "ping_interval": TIMEOUT,
    "max_outstanding_pings": 1,
    # Nothing is buffered while the connection is lost: it would be sent too late.
    "pending_size": -1,
}

# The most URLs of an engine.
MOST_SERVERS = 32

# Variable that names a file -> the option of nats-py, and what the file must contain.
FILES: dict[str, tuple[str, tuple[str, ...]]] = {
    "NATS_CREDS": ("user_credentials", ("BEGIN NATS USER JWT", "BEGIN USER NKEY SEED")),
    "NATS_NKEY": ("nkeys_seed_str", ("SU",)),
}


class FileText(UserString):
    """
    The text of the file that a variable names, which nats-py takes for credentials, as often as it
    needs them: the text that the file contains then, or the former if that is wrong. nats-py itself
    would read a file without credentials for ever, while nothing else runs.
    """

    def __init__(self, name: str, path: str, *keys: str) -> None:
        self._content = RenewedValue(partial(_secret, f"{name}: {path}", path, keys))

    @property
    def data(self) -> str:  # type: ignore[override]
        return self._content.fresh()

    def strip(self, chars: str | None = None) -> Any:
        return UserString(self.data.strip(chars))


def _secret(where: str, path: str, keys: tuple[str, ...]) -> str:
    try:
        text = read_secret(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{where}: {getattr(error, 'strerror', None) or error}") from None
    for name in keys:
        if name not in text:
            raise ValueError(f"{where}: contains no {name!r}")
    return text


def parse_servers(text: str) -> list[str]:
    """Parse the URLs of NATS servers, separated by commas: ``nats://HOST[:4222]`` or ``tls://``."""
    # A password may contain a comma: a text with a login is not split.
    parts = [text] if "@" in text else text.split(",")
    servers = [part.strip() for part in parts if part.strip()]
    if not 1 <= len(servers) <= MOST_SERVERS:
        raise ValueError(f"engine: 1..{MOST_SERVERS} URLs such as nats://192.0.2.1, not {text!r}")
    for server in servers:
        server_url("engine", server, PORTS, example="nats://192.0.2.1:4222", login=LOGIN)
    return servers


async def open_connection(
    servers: list[str],
    *,
    name: str,
    on_change: Callable[[], None] = lambda: None,
    environment: Mapping[str, str] = os.environ,
) -> Client:
    """
    Return a client that is connected, and reconnects to any of the servers without limit.

    Args:
        name: the name of this client on the servers.
        on_change: called when the connection was lost, established again, or closed.
    """
    try:
        from .client import SteadyClient
    except ImportError:
        raise EngineError(what_is_missing("NATS", "nats")) from None

    options = {"name": name, **_identity(environment), **_trust(servers, environment)}
    client = SteadyClient()
    await _connect(client, servers, options, on_change)
    client.options["max_reconnect_attempts"] = -1
    version = client.connected_server_version
    if (version.major, version.minor) < OLDEST:
        await disconnect(client)
        oldest = ".".join(map(str, OLDEST))
        text = f"nats-server {version.major}.{version.minor}.{version.patch} is too old"
        raise EngineError(f"{','.join(servers)}: {text}; {oldest} or newer is needed")
    return client


async def _connect(
    client: Client, servers: list[str], options: dict[str, Any], on_change: Callable[[], None]
) -> None:
    import nats.errors

    failures: list[Exception] = []

    async def failed(error: Exception) -> None:
        # The first reason is raised; the client goes on to call this while it reconnects.
        if not failures and not isinstance(error, nats.errors.NoServersError | TimeoutError):
            failures.append(error)

    async def changed() -> None:
        on_change()

    callbacks: dict[str, Any] = dict.fromkeys(
        ("disconnected_cb", "reconnected_cb", "closed_cb"), changed
    )
    try:
        async with asyncio.timeout(TIMEOUT * (len(servers) + 1)):
            await client.connect(servers, error_cb=failed, **callbacks, **TIMES, **options)
    except BaseException as error:
        # nats-py does not close its socket when connect() fails.
        await disconnect(client)
        if not isinstance(error, Exception):
            raise
        reason = failures[0] if failures else error
        raise EngineGone(f"{','.join(servers)}: {explanation_of(reason)}") from None


async def disconnect(client: Client) -> None:
    await finish(client.close(), 1.0)


def _identity(environment: Mapping[str, str]) -> dict[str, Any]:
    names = {"NATS_USER": "user", "NATS_PASSWORD": "password", "NATS_TOKEN": "token"}
    options: dict[str, Any] = {
        key: environment[name] for name, key in names.items() if environment.get(name)
    }
    for name, (key, keys) in FILES.items():
        if environment.get(name):
            if find_spec("nkeys") is None:
                raise EngineError(f"{name} needs nkeys: pip install nkeys")
            try:
                options[key] = FileText(name, environment[name], *keys)
            except ValueError as error:
                raise EngineError(str(error)) from None
    return options


def _trust(servers: list[str], environment: Mapping[str, str]) -> dict[str, Any]:
    ca, cert, key = (environment.get(name) for name in ("NATS_CA", "NATS_CERT", "NATS_KEY"))
    if not (ca or cert or any(server.startswith("tls:") for server in servers)):
        return {}

    def context() -> ssl.SSLContext:
        try:
            context = ssl.create_default_context(cafile=ca or None)
            if cert:
                context.load_cert_chain(cert, key or None)
        except OSError as error:
            files = ", ".join(filter(None, (ca, cert, key)))
            raise ValueError(
                f"NATS_CA, NATS_CERT, NATS_KEY: {files}: {explanation_of(error)}"
            ) from None
        return context

    try:
        return {"tls": RenewedValue(context)}
    except ValueError as error:
        raise EngineError(str(error)) from None


# --- errors ----------------------------------------------------------------------------------

# The numbers of those errors of JetStream that pass: there is no leader, or servers are not up.
TRANSIENT = (10005, 10008, 10009, 10023)

# The texts of some, in place of those of the server.
TEXTS = {
    10005: "too few servers are up to store three copies",
    10008: "JetStream has no leader now; are most of the servers up?",
    10076: "JetStream is off; nats-server needs -js",
}


class EngineError(Exception):
    """NATS cannot be used. The message begins with the URL or the name of the bucket."""


class NoBucket(EngineError):
    """The bucket does not exist."""


class EngineGone(EngineError):
    """NATS does not respond now, but may do so later."""


@contextlib.contextmanager
def engine_errors(where: str) -> Iterator[None]:
    """Raise an `EngineError` about a URL or bucket in place of the exceptions of nats-py."""
    import nats.errors as basic
    import nats.js.errors as js

    try:
        yield
    except js.BucketNotFoundError:
        raise NoBucket(f"{where}: there is no fleet yet; put it there with --push") from None
    except (basic.Error, OSError) as error:
        lasting = js.NoStreamResponseError | basic.NoRespondersError | basic.MaxPayloadError
        is_lasting = isinstance(error, lasting) or (
            isinstance(error, js.APIError) and error.err_code not in TRANSIENT
        )
        kind = EngineError if is_lasting else EngineGone
        raise kind(f"{where}: {explanation_of(error)}") from None


def explanation_of(error: BaseException) -> str:
    """Return the explanation of an exception of nats-py."""
    import nats.errors as basic
    import nats.js.errors as js

    match error:
        case js.APIError(err_code=code, description=text):
            return TEXTS.get(code or 0) or text or "JetStream is off or not ready"
        case js.NoStreamResponseError() | basic.NoRespondersError():
            return "JetStream is off, or the stream was deleted; nats-server needs -js"
        case ssl.SSLCertVerificationError():
            return f"the certificate is not trusted: {in_words(error)}; see NATS_CA"
        case ssl.SSLError():
            return f"TLS failed: {in_words(error)}"
        case TimeoutError():
            return "no answer; are most of the servers up?"
        case (
            ConnectionError(args=())
            | basic.NoServersError()
            | basic.OutboundBufferLimitError()
            | basic.ConnectionClosedError()
            | basic.ConnectionReconnectingError()
            | basic.StaleConnectionError()
        ):
            return "no server responds"
        case OSError(errno=int(number)) if number:
            # asyncio puts the address in place of the reason.
            return os.strerror(number) if number > 0 else str(error.strerror)
    if "authorization violation" in str(error).lower():
        return "the server refuses the credentials; see NATS_USER, NATS_PASSWORD, NATS_CREDS"
    return str(error).removeprefix("nats: ").strip("'\" ") or type(error).__name__
