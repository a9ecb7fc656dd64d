"""
The connection to NATS: credentials and trust from URLs and the environment; and servers that are
not NATS, or one that is damaged, which are told in one line and of which nothing stays open.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py.services.engine import client as steady
from libmodbus_py.services.engine import connection
from libmodbus_py.services.engine.connection import (
    MOST_SERVERS,
    TIMES,
    EngineError,
    EngineGone,
    open_connection,
    parse_servers,
)
from tests.support.certificates import authority, make, save
from tests.support.secret_files import write_secret

SERVERS = ["nats://192.0.2.1"]


class Client:
    """Notes how somebody connects; see `nats.aio.client.Client`."""

    version = (2, 9, 0)
    error: BaseException | None = None
    errors_before: tuple[Exception, ...] = ()
    made: list[Client]

    def __init__(self) -> None:
        self.options: dict[str, Any] = {}
        self.is_closed = False
        self.made.append(self)

    async def connect(self, servers: list[str], **options: Any) -> None:
        self.servers, self.options = servers, dict(options)
        for entry in self.errors_before:
            await options["error_cb"](entry)
        if self.error is not None:
            raise self.error

    @property
    def connected_server_version(self) -> Any:
        return SimpleNamespace(**dict(zip(("major", "minor", "patch"), self.version, strict=True)))

    async def close(self) -> None:
        self.is_closed = True


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> type[Client]:
    kind: type[Client] = type("Made", (Client,), {"made": []})
    monkeypatch.setattr(steady, "SteadyClient", kind)
    return kind


def connect(*, servers: list[str] = SERVERS, **environment: str) -> Client:
    made: Any = asyncio.run(open_connection(servers, name="worker a", environment=environment))
    assert isinstance(made, Client)
    assert not made.is_closed
    return made


def refused(client: type[Client], **environment: str) -> str:
    with pytest.raises(EngineError) as caught:
        connect(**environment)
    assert all(peer.is_closed for peer in client.made)
    return str(caught.value)


def test_credentials_come_from_the_environment(client: type[Client], monkeypatch, tmp_path) -> None:
    creds, seed = tmp_path / "c", tmp_path / "n"
    write_secret(creds, "BEGIN NATS USER JWT, BEGIN USER NKEY SEED")
    write_secret(seed, "SUA")
    monkeypatch.setattr(connection, "find_spec", lambda name: name)
    made = connect(
        NATS_USER="u",
        NATS_PASSWORD="p",
        NATS_TOKEN="t",
        NATS_CREDS=str(creds),
        NATS_NKEY=str(seed),
        NATS_X="x",
    )
    credentials = {key: made.options.get(key) for key in ("user", "password", "token")}
    assert credentials == {"user": "u", "password": "p", "token": "t"}
    assert made.options["user_credentials"] == creds.read_text()
    assert made.options["nkeys_seed_str"] == "SUA"
    assert "x" not in made.options.values()


@pytest.mark.parametrize("name", ["NATS_CREDS", "NATS_NKEY"])
def test_keys_need_nkeys_and_nothing_else_does(name, client: type[Client], monkeypatch) -> None:
    monkeypatch.setattr(connection, "find_spec", lambda name: None)
    assert refused(client, **{name: "file"}) == f"{name} needs nkeys: pip install nkeys"
    assert client.made == []
    connect(**{name: ""}, NATS_USER="u")


def test_an_option_or_a_url_switches_tls_on(client: type[Client], tmp_path: Path) -> None:
    ca = save(tmp_path, authority(), "ca").cert
    assert "tls" in connect(servers=["nats://192.0.2.1", "tls://192.0.2.2"]).options
    assert "tls" in connect(NATS_CA=str(ca)).options
    one = save(tmp_path, make("one of ours", authority()), "one")
    assert "tls" in connect(NATS_CERT=str(one.cert), NATS_KEY=str(one.key)).options


def test_a_missing_file_is_named(client: type[Client]) -> None:
    text = refused(client, NATS_CA="/nowhere/ca.pem")
    assert text.startswith("NATS_CA, NATS_CERT, NATS_KEY: /nowhere/ca.pem: No such file")
    assert client.made == []


async def test_a_lost_connection_is_retried_for_ever_and_changes_are_reported(
    client: type[Client],
) -> None:
    changes: list[None] = []
    connection: Any = await open_connection(
        SERVERS, name="a", on_change=lambda: changes.append(None), environment={}
    )
    assert connection.options["max_reconnect_attempts"] == -1
    for event in ("disconnected_cb", "reconnected_cb", "closed_cb"):
        await connection.options[event]()
    assert len(changes) == 3


@pytest.mark.parametrize("version", [(2, 9, 0), (3, 0, 0), (2, 8, 9), (1, 10, 0)])
def test_a_server_must_be_new_enough(version: Any, client: type[Client]) -> None:
    client.version = version
    if version >= (2, 9, 0):
        connect()
    else:
        text = f"nats-server {'.'.join(map(str, version))} is too old; 2.9 or newer is needed"
        assert refused(client) == f"nats://192.0.2.1: {text}"


def test_the_first_reason_is_reported(client: type[Client]) -> None:
    import nats.errors

    client.error = nats.errors.NoServersError()
    client.errors_before = (TimeoutError(), ConnectionRefusedError(111, "refused"), OSError(5, ""))
    with pytest.raises(EngineGone, match=r"^nats://192.0.2.1: Connection refused$"):
        connect()
    client.errors_before = ()
    assert refused(client) == "nats://192.0.2.1: no server responds"


def test_a_cancelled_connect_closes_its_client(client: type[Client]) -> None:
    client.error = asyncio.CancelledError()
    with pytest.raises(asyncio.CancelledError):
        connect()
    assert client.made[0].is_closed


@pytest.mark.parametrize(
    ("text", "servers"),
    [
        ("nats://192.0.2.1", ["nats://192.0.2.1"]),
        (" nats://a:1 , ,tls://b:65535/", ["nats://a:1", "tls://b:65535/"]),
        (",".join(["nats://a"] * MOST_SERVERS), ["nats://a"] * MOST_SERVERS),
    ],
)
def test_servers_are_parsed(text: str, servers: list[str]) -> None:
    assert parse_servers(text) == servers


@pytest.mark.parametrize(
    "text",
    [
        *("", " , ", ",".join(["nats://a"] * (MOST_SERVERS + 1)), "http://a", "nats://", "a:4222"),
        *("nats://a/path", "nats://a:0", "nats://a:65536", "nats://a:x"),
    ],
)
def test_a_url_without_a_server_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="engine"):
        parse_servers(text)


INFO = b'INFO {"server_id":"x","version":"2.9.0","max_payload":1000}\r\n'

# What it says as soon as somebody is connected, and then no more.
SAID = {
    "nothing": b"",
    "rubbish": b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "no JSON": b"INFO {\r\n",
    "who it is": INFO,
    "that it wants TLS": b'INFO {"server_id":"x","version":"2.9.0","tls_required":true}\r\n',
    "that it wants a password": INFO + b"-ERR 'Authorization Violation'\r\n",
    "an old version": b'INFO {"server_id":"x","version":"2.1.0"}\r\nPONG\r\n',
}


@contextlib.asynccontextmanager
async def saying(line: bytes, *, closes: bool) -> AsyncIterator[str]:
    over = asyncio.Event()

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(line)
        if not closes:
            await over.wait()
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"nats://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        over.set()
        server.close()
        await asyncio.sleep(0.05)


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


async def fails(line: bytes, closes: bool, patience: float) -> str:
    """Connect; return what is wrong with how that failed, if anything."""
    async with saying(line, closes=closes) as url:
        try:
            async with asyncio.timeout(patience):
                await open_connection([url], name="test")
        except TimeoutError:
            return "" if patience < 1 else "nobody gave up"
        except EngineError as error:
            is_right = str(error).startswith(f"{url}: ") and "Error" not in str(error)
            return "" if is_right else str(error)
    return "connected"


@pytest.mark.parametrize("closes", [False, True], ids=["stays", "closes"])
def test_a_connection_that_ends_in_its_handshake_leaves_no_descriptor_open(monkeypatch, closes):
    """If nats-py notices it, or a caller that connects waits no longer."""
    monkeypatch.setattr(connection, "TIMEOUT", 0.5)
    monkeypatch.setitem(TIMES, "connect_timeout", 0.5)

    async def go() -> dict[tuple[str, float], str]:
        cases = [(name, patience) for name in SAID for patience in (0.1, 30)]
        trials = (fails(SAID[name], closes, patience) for name, patience in cases)
        return dict(zip(cases, await asyncio.gather(*trials), strict=True))

    before = descriptors()
    assert {case: wrong for case, wrong in asyncio.run(go()).items() if wrong} == {}
    assert descriptors() == before
