"""
Modbus Security at the server: with clients that others wrote.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import certificates
import pytest
from certificates import Papers

from libmodbus_py import Access, Context, Device, Mapping, Server

SEEN = "seen"


@pytest.fixture
def papers(tmp_path: Path) -> Papers:
    return Papers(tmp_path)


@pytest.fixture
def roles() -> list[str | None]:
    """The roles of those who wrote."""
    return []


@pytest.fixture
def server(papers: Papers, roles: list[str | None]) -> Server:
    def note(access: Access) -> None:
        roles.append(access.role)

    device = Device(Mapping(10, 10, 100, 100), before_write=note)
    return Server(device, security=papers.server())


@pytest.fixture
def url(server: Server) -> Iterator[str]:
    with server.background("tls://127.0.0.1:0") as running:
        yield running.urls[0]


def test_the_role_of_a_certificate_reaches_the_hooks(
    url: str, papers: Papers, roles: list[str | None]
) -> None:
    for role in ("Operator", None, "Überwacher"):
        with Context.from_url(url, security=papers.client(role)) as plc:
            plc.write_register(3, 77)
            assert plc.read_holding_registers(3, 1) == [77]
    assert roles == ["Operator", None, "Überwacher"]


def test_urls_may_say_who_one_is(papers: Papers) -> None:
    device = Device(Mapping(holding_registers=[range(5)]))
    listen = papers.url("tls://127.0.0.1:0", certificates.server())
    with Server(device).background(listen) as running:
        assert "?" not in running.urls[0]
        with Context.from_url(papers.url(running.urls[0], certificates.client())) as plc:
            assert plc.read_holding_registers(0, 5) == [0] * 5
