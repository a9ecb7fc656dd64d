"""
The table of transports: every one has a port for clients and an endpoint for servers.
"""

from pathlib import Path
from typing import get_args

import pytest

from libmodbus_py import Client
from libmodbus_py.cli.arguments import SCHEMES_OF_URLS, URLS
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.making import port_class
from libmodbus_py.ports.schemes import SCHEMES, TRANSPORTS, Scheme, Transport, shape_of
from tests.support.certificates import Papers
from tests.support.urls import rules_of, url_for

KNOWN: dict[Scheme, set[str]] = {
    "tcp": {"has_transactions"},
    "rtu+tcp": set(),
    "ascii+tcp": set(),
    "udp": {"has_transactions", "is_datagram"},
    "rtu+udp": {"is_datagram"},
    "tls": {"has_transactions", "is_secure"},
    "rtu": {"has_path", "is_serial"},
    "ascii": {"has_path", "is_serial"},
}
"""
Scheme -> which of `PROPERTIES` its endpoints have.

These may not change; of other schemes their own tests tell it.
"""

URLS_PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "read-and-write.md"

PROPERTIES = ["has_path", "has_transactions", "is_datagram", "is_secure", "is_serial"]


def test_each_transport_has_a_port_an_endpoint_and_a_scheme() -> None:
    assert set(TRANSPORTS) == set(get_args(Transport))
    assert {transport for _, transport in SCHEMES.values()} == set(TRANSPORTS)
    assert set(SCHEMES) == set(get_args(Scheme))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_each_scheme_has_a_port(scheme: Scheme, tmp_path: Path) -> None:
    rules = rules_of(scheme)
    url = url_for(scheme, "127.0.0.1", line="/dev/null")
    security = {"security": Papers(tmp_path).client()} if rules.is_secure else {}
    client = Client(url, **security)
    if scheme in KNOWN:
        assert {name for name in PROPERTIES if getattr(parse(url), name)} == KNOWN[scheme]
    assert type(client._driver._port) is port_class(SCHEMES[scheme][1])


def test_every_scheme_is_in_the_table_of_the_documentation() -> None:
    text = URLS_PAGE.read_text().partition("| URL | endpoint |")[2]
    table = text.partition("\n\n")[0]
    assert [scheme for scheme in SCHEMES if f"`{scheme}://" not in table] == []


@pytest.mark.parametrize("scheme", SCHEMES)
def test_help_texts_name_every_scheme(scheme: Scheme) -> None:
    assert f" {scheme}://" in SCHEMES_OF_URLS
    assert f" {shape_of(scheme)}" in URLS
    assert max(map(len, f"{SCHEMES_OF_URLS}\n{URLS}".splitlines())) <= 79
