"""
Revocation lists: what is read, and what is refused by name.
"""

import re
from pathlib import Path

import pytest

from libmodbus_py import Security
from libmodbus_py.security.files import PemFile, Revoked
from tests.support import certificates
from tests.support.cases import each_case
from tests.support.certificates import Files, Papers

PEM = b"-----BEGIN X509 CRL-----\n%s\n-----END X509 CRL-----\n"


@pytest.fixture
def files(papers: Papers) -> Files:
    return papers.files(certificates.client())


def saved(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def crl(path: Path, content: bytes) -> PemFile:
    return PemFile("crl", saved(path, content))


def test_a_list_tells_which_certificates_are_revoked(tmp_path: Path) -> None:
    one, other = certificates.client(), certificates.server()
    found = Revoked(crl(tmp_path / "crl", certificates.revocation_list(one)))
    assert found.any_of([one.der])
    assert found.any_of([other.der, one.der])
    assert not found.any_of([other.der])


def test_a_number_is_revoked_for_its_own_authority_only(tmp_path: Path) -> None:
    """Two authorities may give one number to two certificates (RFC 5280, 5.3)."""
    lower = certificates.intermediate()
    listed = certificates.revocation_list(certificates.client(), issuer=lower)
    assert not Revoked(crl(tmp_path / "crl", listed)).any_of([certificates.client().der])


def test_a_file_may_have_several_lists_and_ends_with_the_first_of_them(tmp_path: Path) -> None:
    lower = certificates.intermediate()
    one, two = certificates.client(), certificates.client(issuer=lower)
    both = certificates.revocation_list(one, days=20) + certificates.revocation_list(
        two, issuer=lower, days=10
    )
    found = Revoked(crl(tmp_path / "crl", both))
    assert found.any_of([one.der])
    assert found.any_of([two.der])
    sooner = Revoked(
        crl(tmp_path / "one", certificates.revocation_list(two, issuer=lower, days=10))
    )
    assert found.ends is not None
    assert sooner.ends is not None
    assert abs(found.ends - sooner.ends) <= 5


def test_a_file_without_a_list_is_named(tmp_path: Path, papers: Papers, files: Files) -> None:
    good = certificates.revocation_list()
    for content, reason in (
        (b"", "no revocation list in PEM format"),
        (good[:200], "no revocation list in PEM format"),
        (PEM % b"AAAA", "no revocation list in PEM format"),
        (PEM % b"!!!!", "no revocation list in PEM format"),
        (good + papers.ca.read_bytes(), "contains a certificate, which has no effect"),
        (good + b"-----BEGIN X509 CRL-----\nAAAA\n", "cannot be read"),  # as OpenSSL finds
    ):
        file = saved(tmp_path / "crl", content)
        with pytest.raises(ValueError, match=f"^crl '{re.escape(str(file))}':? {reason}$"):
            Security(files.cert, files.key, trust=papers.ca, crl=file)


@each_case("argument", ["certificate", "trust", "pin"])
def test_what_would_be_ignored_in_a_file_of_certificates_is_refused(
    tmp_path: Path, papers: Papers, files: Files, argument: str
) -> None:
    """Someone who adds a revocation list to the authorities expects it to have an effect."""
    reason = "contains a revocation list, which must be given as crl"
    file = saved(tmp_path / "file", files.cert.read_bytes() + certificates.revocation_list())
    options = {"trust": papers.ca} if argument == "certificate" else {}
    with pytest.raises(ValueError, match=f"^{argument} '{re.escape(str(file))}' {reason}"):
        Security(**{"certificate": files.cert, "key": files.key, **options, argument: file})


def test_a_list_needs_authorities(tmp_path: Path, files: Files) -> None:
    listed = saved(tmp_path / "crl", certificates.revocation_list())
    with pytest.raises(ValueError, match=r"^crl needs trust: a pinned certificate is revoked by"):
        Security(files.cert, files.key, pin=files.cert, crl=listed)
