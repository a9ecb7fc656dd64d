"""Certificates that are revoked, and files that are read again."""

import logging
import os
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import Security
from libmodbus_py.security import security as security_module
from libmodbus_py.security.files import PemFile, RevocationLists
from libmodbus_py.security.security import reload_all
from tests.support import certificates
from tests.support.cases import each_case
from tests.support.certificates import Files, Pki

PEM = b"-----BEGIN X509 CRL-----\n%s\n-----END X509 CRL-----\n"


@pytest.fixture
def files(pki: Pki) -> Files:
    return pki.files(certificates.client())


def saved(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def crl(path: Path, content: bytes) -> PemFile:
    return PemFile("crl", saved(path, content))


def test_a_list_tells_which_certificates_are_revoked(tmp_path: Path) -> None:
    one, other = certificates.client(), certificates.server()
    revoked = RevocationLists(crl(tmp_path / "crl", certificates.revocation_list(one)))
    assert revoked.any_of([one.der])
    assert revoked.any_of([other.der, one.der])
    assert not revoked.any_of([other.der])


def test_a_number_is_revoked_for_its_own_authority_only(tmp_path: Path) -> None:
    """Two authorities may give one number to two certificates (RFC 5280, 5.3)."""
    lower = certificates.intermediate()
    listed = certificates.revocation_list(certificates.client(), issuer=lower)
    assert not RevocationLists(crl(tmp_path / "crl", listed)).any_of([certificates.client().der])


def test_a_file_of_several_lists_expires_with_the_first_of_them(tmp_path: Path) -> None:
    lower = certificates.intermediate()
    one, two = certificates.client(), certificates.client(issuer=lower)
    both = certificates.revocation_list(one, days=20) + certificates.revocation_list(
        two, issuer=lower, days=10
    )
    revoked = RevocationLists(crl(tmp_path / "crl", both))
    assert revoked.any_of([one.der])
    assert revoked.any_of([two.der])
    sooner = RevocationLists(
        crl(tmp_path / "one", certificates.revocation_list(two, issuer=lower, days=10))
    )
    assert revoked.ends is not None
    assert sooner.ends is not None
    assert abs(revoked.ends - sooner.ends) <= 5


def test_a_file_without_a_list_is_named(tmp_path: Path, pki: Pki, files: Files) -> None:
    good = certificates.revocation_list()
    for content, reason in (
        (b"", "no revocation list in PEM format"),
        (good[:200], "no revocation list in PEM format"),
        (PEM % b"AAAA", "no revocation list in PEM format"),
        (PEM % b"!!!!", "no revocation list in PEM format"),
        (good + pki.ca.read_bytes(), "contains a certificate, which has no effect"),
        (good + b"-----BEGIN X509 CRL-----\nAAAA\n", "cannot be read"),  # as OpenSSL finds
    ):
        file = saved(tmp_path / "crl", content)
        with pytest.raises(ValueError, match=f"^crl '{re.escape(str(file))}':? {reason}$"):
            Security(files.cert, files.key, trust=pki.ca, crl=file)


@each_case("argument", ["certificate", "trust", "pin"])
def test_other_contents_in_a_file_of_certificates_are_refused(
    tmp_path: Path, pki: Pki, files: Files, argument: str
) -> None:
    """Someone who adds a revocation list to the authorities expects it to have an effect."""
    reason = "contains a revocation list, which must be given as crl"
    file = saved(tmp_path / "file", files.cert.read_bytes() + certificates.revocation_list())
    options = {"trust": pki.ca} if argument == "certificate" else {}
    with pytest.raises(ValueError, match=f"^{argument} '{re.escape(str(file))}' {reason}"):
        Security(**{"certificate": files.cert, "key": files.key, **options, argument: file})


def test_a_revocation_list_needs_authorities(tmp_path: Path, files: Files) -> None:
    listed = saved(tmp_path / "crl", certificates.revocation_list())
    with pytest.raises(ValueError, match=r"^crl needs trust: a pinned certificate is revoked by"):
        Security(files.cert, files.key, pin=files.cert, crl=listed)


DAY = 86_400


@pytest.mark.parametrize("what", ["certificate", "key", "trust", "pin", "crl"])
def test_a_mistake_in_a_file_changes_nothing(tmp_path: Path, pki: Pki, what: str) -> None:
    files = pki.files(certificates.client())
    listed = tmp_path / "crl"
    listed.write_bytes(certificates.revocation_list())
    options: dict[str, Any] = {"pin": tmp_path / "pin"}
    (tmp_path / "pin").write_bytes(files.cert.read_bytes())
    if what != "pin":
        options = {"trust": pki.ca, "crl": listed}
    security = Security(files.cert, files.key, **options)
    security.check_server()
    before = security.loaded
    broken = {"certificate": files.cert, "key": files.key, "crl": listed, **options}[what]
    Path(broken).write_text("in the midst of being written")
    with pytest.raises(ValueError, match=f"^{what} "):
        security.reload()
    assert security.loaded is before
    assert any(line.startswith(f"the former content is used: {what} ") for line in reload_all())
    Path(broken).unlink()
    assert any("No such file" in line for line in reload_all())


def test_a_certificate_without_its_new_key_changes_nothing(pki: Pki) -> None:
    """Whoever renews both writes one first."""
    files = pki.files(certificates.client())
    security = Security(files.cert, files.key, trust=pki.ca)
    files.cert.write_bytes(certificates.client("Viewer").pem)
    with pytest.raises(ValueError, match="not the key of the certificate"):
        security.reload()
    assert security.own == certificates.client().der


def test_pins_from_an_iterator_can_be_read_again(pki: Pki) -> None:
    files = pki.files(certificates.client())
    security = Security(files.cert, files.key, pin=iter([files.cert]))
    security.reload()
    assert security.accepts(certificates.client().der)


def at(monkeypatch: pytest.MonkeyPatch, when: float) -> None:
    monkeypatch.setattr(security_module, "time", SimpleNamespace(time=lambda: when))


def test_an_approaching_expiry_is_logged_once_a_day(pki: Pki, monkeypatch, caplog) -> None:
    files = pki.files(certificates.server(days=100))
    security = Security(files.cert, files.key, trust=pki.ca)
    end = certificates.end(certificates.server(days=100).certificate).timestamp()
    assert security.ends == end
    for days, text in (
        (60, None),
        (31, None),
        (29, "expires in 29 days"),
        (28.5, None),
        (27.9, "expires in 28 days"),
        (1.5, "expires within two days"),
        (-0.1, "has expired"),
    ):
        caplog.clear()
        at(monkeypatch, end - days * DAY)
        with caplog.at_level(logging.WARNING):
            security.warn_of_end()
            security.warn_of_end()
        messages = [] if text is None else [f"certificate {os.fspath(files.cert)!r} {text}"]
        assert caplog.messages == messages, days


def test_the_end_of_a_revocation_list_is_logged(tmp_path, pki: Pki, caplog) -> None:
    """When it has ended, OpenSSL refuses everybody."""
    listed = tmp_path / "crl"
    security = pki.server(crl=written(listed, days=3))
    for days, text in ((3, None), (1, "expires within two days"), (-1, "has expired")):
        written(listed, days=days)
        security.reload()
        caplog.clear()
        security.warn_of_end()
        assert caplog.messages == ([] if text is None else [f"crl {str(listed)!r} {text}"])


def written(file: Path, *, days: float) -> Path:
    file.write_bytes(certificates.revocation_list(days=days))
    return file
