"""
The maker of certificates: their keys, chains and files.
"""

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from libmodbus_py.tools.certificates import write
from tests.support import certificates


def test_keys_are_p_256() -> None:
    key = certificates.server().key
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    assert key.curve.name == "secp256r1"


def test_a_chain_goes_along() -> None:
    below = certificates.client(issuer=certificates.intermediate())
    assert below.pem.count(b"BEGIN CERTIFICATE") == 2
    assert certificates.client().pem.count(b"BEGIN CERTIFICATE") == 1


def test_files_are_their_owners_alone_and_never_overwritten(tmp_path: Path) -> None:
    made = {"ca": certificates.authority(), "client": certificates.client()}
    paths = write(tmp_path / "new", made)
    assert [path.name for path in paths["client"]] == ["client.pem", "client-key.pem"]
    assert {path.stat().st_mode & 0o777 for _, path in paths.values()} == {0o600}
    before = paths["client"][1].read_bytes()
    with pytest.raises(FileExistsError, match=r"ca\.pem"):
        write(tmp_path / "new", made)
    assert paths["client"][1].read_bytes() == before


def test_all_files_or_none(tmp_path: Path) -> None:
    (tmp_path / "client-key.pem").write_text("mine")
    with pytest.raises(FileExistsError, match=r"client-key\.pem"):
        write(tmp_path, {"ca": certificates.authority(), "client": certificates.client()})
    assert [path.name for path in tmp_path.iterdir()] == ["client-key.pem"]
    assert (tmp_path / "client-key.pem").read_text() == "mine"
