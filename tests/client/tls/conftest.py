"""Clients and servers over TLS."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py.tools.certificates import Identity
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.clients import Connect
from tests.support.secured import context_of
from tests.support.tls_clients import LONG, Serving, Talking
from tests.support.tls_peers import Peer, Script, TlsServer


@pytest.fixture(params=["1.2", "1.3"])
def version(request: pytest.FixtureRequest) -> str:
    value: str = request.param
    return value


@pytest.fixture
def serving(pki: Pki) -> Serving:
    """Makes a server; options of `context_of`."""

    def make(
        script: Script = Peer.serve,
        identity: Identity | None = None,
        version: str | None = None,
        **options: Any,
    ) -> TlsServer:
        certificate = identity or certificates.server()
        return TlsServer(context_of(pki, certificate, version, **options), script)

    return make


@pytest.fixture
def talking(connect: Connect, pki: Pki, serving: Serving) -> Talking:
    """Makes a server as `serving` does, and a client that it trusts; `client` has its options."""

    @contextmanager
    def talk(
        *arguments: Any, client: Mapping[str, Any] = {}, **options: Any
    ) -> Iterator[tuple[TlsServer, Any]]:
        with (
            serving(*arguments, **options) as server,
            connect(server.url, **{"security": pki.client(), "timeout": LONG, **client}) as plc,
        ):
            yield server, plc

    return talk
