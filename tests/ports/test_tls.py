"""Who one is at a tls:// endpoint: in its URL or as given, and what is wrong with it."""

import re
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, Security
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.tls import security_of
from tests.support import certificates
from tests.support.certificates import Pki

SECRET = "open sesame"


@pytest.mark.parametrize("make", [Client, AsyncClient])
def test_security_needs_tls_and_tls_needs_security(make: Any, pki: Pki) -> None:
    security = pki.client()
    url = pki.url("tls://h", certificates.client())
    for wrong, options, text in (
        ("tcp://h", {"security": security}, "security is for tls:// only, not for tcp://"),
        ("rtu:///dev/x", {"security": security}, "security is for tls:// only, not for rtu://"),
        ("udp://h", {"security": security}, "security is for tls:// only, not for udp://"),
        ("tls://h", {}, "tls://h:802 needs security: Security(...), or ?cert=...&key=..."),
        (url, {"security": security}, "tls://h:802: security is given as such and in the URL"),
        ("tls://h?ca=x", {}, "tls://h:802 lacks cert, the file with one's own certificate"),
        ("tls://h?cert=x", {}, "tls://h:802 needs either ca, the authorities, or pin, certif"),
        ("tls://h?cert=x&ca=y&pin=z", {}, "tls://h:802 needs either ca, the authorities, or pin"),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(text)}"):
            make(wrong, **options)
    with pytest.raises(TypeError, match="security must be Security, not dict"):
        make("tls://h", security={})
    with pytest.raises(TypeError, match="'securty' must be one of unit, timeout"):
        make("tls://h", securty=security)
    assert make(url).url == make("tls://h", security=security).url == "tls://h:802"


def test_a_client_accepts_a_security_of_its_own(pki: Pki) -> None:
    security = pki.client()
    assert Client("tls://h", security=security).url == "tls://h:802"
    with pytest.raises(ValueError, match="tls://h:802 needs security"):
        Client("tls://h")


def test_options_of_a_url_make_a_security(pki: Pki, monkeypatch: pytest.MonkeyPatch) -> None:
    files = pki.files(certificates.client(), SECRET.encode())
    monkeypatch.setenv("KEY_PASSWORD", SECRET)
    both = f"cert={files.cert}&key={files.key}&password_env=KEY_PASSWORD"
    for more in (f"ca={pki.ca}", f"pin={pki.ca},{'ab' * 32}", f"ca={pki.ca}&server_name=x"):
        assert isinstance(security_of(parse(f"tls://h?{both}&{more}"), None), Security)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"cert": "/nowhere"}, "certificate '/nowhere': No such file or directory"),
        ({"cert": "/"}, "certificate '/': Is a directory"),
        ({"key": "OTHER"}, "key 'OTHER': not the key of the certificate"),
        ({"password_env": "NO_SUCH"}, "password_env: no environment variable 'NO_SUCH'"),
        ({"server_name": ""}, "server_name must be a name or an address, not ''"),
        ({"key": "LOCKED"}, "key 'LOCKED' is encrypted, and needs its password"),
        ({"key": "LOCKED", "password_env": "WRONG"}, "key 'LOCKED': the password is another"),
        ({"key": "LOCKED", "password_env": "EMPTY"}, "key 'LOCKED'"),
    ],
)
def test_the_fault_of_a_file_is_named(pki: Pki, monkeypatch, change, text) -> None:
    monkeypatch.setenv("WRONG", "close sesame")
    monkeypatch.setenv("EMPTY", "")
    own = pki.files(certificates.client())
    files = {
        "CERT": own.cert,
        "KEY": own.key,
        "OTHER": pki.files(certificates.server()).key,
        "LOCKED": pki.files(certificates.client(), SECRET.encode()).key,
    }
    options = {"cert": "CERT", "key": "KEY", "ca": str(pki.ca), **change}
    for name, file in files.items():
        options = {entry: str(file) if value == name else value for entry, value in options.items()}
        text = text.replace(f"'{name}'", repr(str(file)))
    url = "tls://h?" + "&".join(f"{name}={value}" for name, value in options.items())
    with pytest.raises(ValueError, match=f"^{re.escape(text)}") as caught:
        security_of(parse(url), None)
    assert "sesame" not in str(caught.value)


def test_no_text_shows_the_password(pki: Pki, monkeypatch: pytest.MonkeyPatch) -> None:
    files = pki.files(certificates.client(), SECRET.encode())
    security = Security(files.cert, files.key, trust=pki.ca, password=SECRET)
    monkeypatch.setenv("KEY_PASSWORD", SECRET)
    url = f"tls://h?cert={files.cert}&key={files.key}&ca={pki.ca}&password_env=KEY_PASSWORD"
    for plc in (Client("tls://h", security=security), Client(url)):
        for entry in (security, plc, plc.url, plc.statistics, vars(plc), plc._driver):
            assert SECRET not in repr(entry)
