"""
The openssl command on certificates of ours: what it reads in them, and that it takes them.
"""

import re
import subprocess
from pathlib import Path

import pytest

from libmodbus_py.security.role import ROLE_OID, role_of
from libmodbus_py.tools.certificates import make
from tests.support import certificates


def openssl(*arguments: object) -> str:
    command = ["openssl", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("role", ["Operator", "Prüfer", "x" * 200])
def test_it_reads_the_role_as_a_utf8string(tmp_path: Path, role: str) -> None:
    files = certificates.save(tmp_path, certificates.client(role), "client")
    parsed = openssl("asn1parse", "-in", files.cert)
    # The identifier, by number for it has no name, and behind it the octets of the extension.
    octets = re.search(rf":{re.escape(ROLE_OID)}\n.*OCTET STRING +\[HEX DUMP\]:(\w+)\n", parsed)
    assert octets
    (tmp_path / "role.der").write_bytes(bytes.fromhex(octets[1]))
    inner = openssl("asn1parse", "-inform", "DER", "-in", tmp_path / "role.der")
    assert re.fullmatch(
        rf" +0:d=0 +hl=[23] l= *{len(role.encode())} prim: UTF8STRING +:.*\n", inner
    )
    if role.isascii():
        assert inner.rstrip("\n").endswith(f":{role}")
        text = openssl("x509", "-in", files.cert, "-noout", "-text")
        assert re.search(rf"{re.escape(ROLE_OID)}: *\n.*{role}\n", text)


def test_it_takes_them_strictly_for_both_purposes(tmp_path: Path) -> None:
    ca = certificates.save(tmp_path, certificates.authority(), "ca").cert
    below = certificates.intermediate()
    middle = certificates.save(tmp_path, below, "middle").cert
    for issuer in (certificates.authority(), below):
        identity = make("one of ours", issuer, hosts=certificates.HOSTS, role="Operator")
        cert = certificates.save(tmp_path, identity, "one").cert
        for purpose in ("sslserver", "sslclient"):
            openssl(
                *("verify", "-x509_strict", "-check_ss_sig", "-purpose", purpose),
                *("-CAfile", ca, "-untrusted", middle, "-verify_ip", "127.0.0.1", cert),
            )


def test_we_read_the_role_in_what_it_makes(tmp_path: Path) -> None:
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-keyout", tmp_path / "key.pem", "-out", tmp_path / "cert.der", "-outform", "DER"),
        *("-subj", "/CN=peer", "-addext", f"{ROLE_OID}=ASN1:UTF8String:Operator"),
    )
    assert role_of((tmp_path / "cert.der").read_bytes()) == "Operator"
