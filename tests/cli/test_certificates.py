"""
The command certificates: what lies in the directory afterwards.
"""

from __future__ import annotations

import shlex
import ssl
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509

from libmodbus_py.protocol.extras import how_to_add
from libmodbus_py.security.role import role_of
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import Done, run


def made(*arguments: object) -> Done:
    return run("certificates", *arguments)


def load(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def role_in(path: Path) -> str | None:
    return role_of(ssl.PEM_cert_to_DER_cert(path.read_text()))


def test_it_makes_an_authority_a_server_and_clients(tmp_path: Path) -> None:
    directory = tmp_path / "new" / "with a space"
    done = made(directory)
    assert (done.code, done.err) == (0, "")
    roles = {path.stem: role_in(path) for path in directory.glob("*.pem") if "key" not in path.name}
    assert roles == {
        **dict.fromkeys(["ca", "server", "no-role"]),
        "viewer": "Viewer",
        "operator": "Operator",
        "engineer": "Engineer",
    }
    keys = [*directory.glob("*-key.pem")]
    assert len(keys) == len(roles)
    assert {key.stat().st_mode & 0o777 for key in keys} == {0o600}
    ca = load(directory / "ca.pem")
    for name in roles:
        load(directory / f"{name}.pem").verify_directly_issued_by(ca)


def test_options(tmp_path: Path) -> None:
    done = made(
        tmp_path,
        *("--host", "plc.example", "--host", "192.0.2.7", "--days", "7"),
        *("--role", "Shift leader", "--role", "Prüfer"),
    )
    assert done.code == 0, done.err
    server = load(tmp_path / "server.pem")
    names = server.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "plc.example"]
    addresses = [str(each) for each in names.get_values_for_type(x509.IPAddress)]
    assert addresses == ["127.0.0.1", "::1", "192.0.2.7"]
    assert role_in(tmp_path / "shift-leader.pem") == "Shift leader"
    assert role_in(tmp_path / "prüfer.pem") == "Prüfer"
    assert not (tmp_path / "operator.pem").exists()
    left = server.not_valid_after_utc - datetime.now(UTC)
    assert timedelta(days=6) < left < timedelta(days=7)


def test_without_cryptography_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = [name for name in sys.modules if name.startswith("libmodbus_py.tools.certificates")]
    for name in missing:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cryptography", None)
    done = made(tmp_path)
    assert done.code == 1
    assert done.err.count("\n") == 1
    assert how_to_add("security") in done.err


def test_the_commands_it_prints_work(tmp_path: Path) -> None:
    serve, read = (shlex.split(line)[1:] for line in made(tmp_path / "a b").out.splitlines()[-2:])
    serve[1] = "tls://127.0.0.1:0"
    with serving(*serve) as (_, read[1]):
        done = run(*read)
    assert (done.out, done.err) == ("    0  0\n", "")


# --- of machines ----------------------------------------------------------------------------

LONG = "a-machine-whose-name-is-longer-than-a-common-name-may-be-in-a-plant.example"


def names_in(path: Path) -> list[str]:
    names = load(path).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(each.value) for each in names]


def test_machines_have_certificates_of_one_authority(tmp_path: Path) -> None:
    machines = ("n1.example", "192.0.2.7", "::1", LONG)
    assert made(tmp_path, *machines[:2]).out.splitlines() == [
        str(tmp_path / name) for name in machines[:2]
    ]
    before = load(tmp_path / machines[0] / "server.pem").serial_number
    assert made(tmp_path, *machines[2:], machines[0]).code == 0
    assert load(tmp_path / machines[0] / "server.pem").serial_number != before
    ca = load(tmp_path / "ca.pem")
    assert (tmp_path / "ca-key.pem").stat().st_mode & 0o777 == 0o600
    for name in machines:
        folder = tmp_path / name
        assert {each.name for each in folder.iterdir()} == {
            *("ca.pem", "server.pem", "server-key.pem")
        }
        load(folder / "server.pem").verify_directly_issued_by(ca)
        assert load(folder / "ca.pem") == ca
        assert names_in(folder / "server.pem") == [name]
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "server.pem", folder / "server-key.pem")
    addresses = load(tmp_path / "::1" / "server.pem").extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert [type(each) for each in addresses.value] == [x509.IPAddress]


@each_case("left", ["", "-----BEGIN PRIVATE KEY-----\nMIGHAgEA"])
def test_a_key_of_an_interrupted_run_is_no_authority(left: str, tmp_path: Path) -> None:
    folder = tmp_path / f"{len(left)} characters"
    folder.mkdir()
    (folder / "ca-key.pem").write_text(left)
    assert made(folder, "n1").code == 0
    assert (folder / "ca-key.pem").stat().st_mode & 0o777 == 0o600
    load(folder / "n1" / "server.pem").verify_directly_issued_by(load(folder / "ca.pem"))


@each_case("left", ["", "-----BEGIN PRIVATE KEY-----\nMIGHAgEA", None])
def test_an_authority_without_its_key_is_named(left: str | None, tmp_path: Path) -> None:
    made(tmp_path, "n1")
    key = tmp_path / "ca-key.pem"
    key.unlink() if left is None else key.write_text(left)
    done = made(tmp_path, "n2")
    assert done.code == 2
    assert f"{key} is not the key of {tmp_path}/ca.pem" in done.err
    assert not (tmp_path / "n2").exists()


def test_what_cannot_be_written_leaves_no_half(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    assert made(tmp_path, "n1").code == 1
    assert made(tmp_path).code == 1
    assert [each for each in tmp_path.rglob("*") if each.is_file()] == []
