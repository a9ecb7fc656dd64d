"""The command certificates, and the files in its directory afterwards."""

import shlex
import ssl
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509

from libmodbus_py.security.certificates import role_of
from libmodbus_py.tools.page.page import TOKEN
from libmodbus_py.version import how_to_add
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import Result, run


def make(*arguments: object) -> Result:
    return run("certificates", *arguments)


def load(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def role_in(path: Path) -> str | None:
    return role_of(ssl.PEM_cert_to_DER_cert(path.read_text()))


def test_the_command_makes_an_authority_a_server_and_clients(tmp_path: Path) -> None:
    directory = tmp_path / "new" / "with a space"
    result = make(directory)
    assert (result.code, result.err) == (0, "")
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


def test_options_set_hosts_and_days_and_roles(tmp_path: Path) -> None:
    result = make(
        tmp_path,
        *("--host", "plc.example", "--host", "192.0.2.7", "--days", "7"),
        *("--role", "Shift leader", "--role", "Prüfer"),
    )
    assert result.code == 0, result.err
    server = load(tmp_path / "server.pem")
    names = server.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "plc.example"]
    addresses = [str(entry) for entry in names.get_values_for_type(x509.IPAddress)]
    assert addresses == ["127.0.0.1", "::1", "192.0.2.7"]
    assert role_in(tmp_path / "shift-leader.pem") == "Shift leader"
    assert role_in(tmp_path / "prüfer.pem") == "Prüfer"
    assert not (tmp_path / "operator.pem").exists()
    lifetime = server.not_valid_after_utc - datetime.now(UTC)
    assert timedelta(days=6) < lifetime < timedelta(days=7)


def test_without_cryptography_the_command_says_what_to_install(tmp_path, monkeypatch) -> None:
    missing = [name for name in sys.modules if name.startswith("libmodbus_py.tools.certificates")]
    for name in missing:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cryptography", None)
    result = make(tmp_path)
    assert result.code == 1
    assert result.err.count("\n") == 1
    assert how_to_add("security") in result.err


def test_the_printed_commands_work(tmp_path: Path) -> None:
    serve, read = (shlex.split(line)[1:] for line in make(tmp_path / "a b").out.splitlines()[-2:])
    serve[1] = "tls://127.0.0.1:0"
    with serving(*serve) as (_, read[1]):
        result = run(*read)
    assert (result.out, result.err) == ("    0  0\n", "")


LONG = "a-machine-whose-name-is-longer-than-a-common-name-may-be-in-a-plant.example"


def names_in(path: Path) -> list[str]:
    names = load(path).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(name.value) for name in names]


def test_certificates_for_machines_come_from_one_authority(tmp_path: Path) -> None:
    machines = ("n1.example", "192.0.2.7", "::1", LONG)
    assert make(tmp_path, *machines[:2]).out.splitlines() == [
        str(tmp_path / name) for name in machines[:2]
    ]
    before = load(tmp_path / machines[0] / "server.pem").serial_number
    assert make(tmp_path, *machines[2:], machines[0]).code == 0
    assert load(tmp_path / machines[0] / "server.pem").serial_number != before
    ca = load(tmp_path / "ca.pem")
    assert (tmp_path / "ca-key.pem").stat().st_mode & 0o777 == 0o600
    for name in machines:
        folder = tmp_path / name
        assert {path.name for path in folder.iterdir()} == {
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
    assert [type(entry) for entry in addresses.value] == [x509.IPAddress]


@each_case("name", ["", "-----BEGIN PRIVATE KEY-----\nMIGHAgEA"])
def test_a_key_of_an_interrupted_run_is_no_authority(name: str, tmp_path: Path) -> None:
    folder = tmp_path / f"{len(name)} characters"
    folder.mkdir()
    (folder / "ca-key.pem").write_text(name)
    assert make(folder, "n1").code == 0
    assert (folder / "ca-key.pem").stat().st_mode & 0o777 == 0o600
    load(folder / "n1" / "server.pem").verify_directly_issued_by(load(folder / "ca.pem"))


@each_case("name", ["", "-----BEGIN PRIVATE KEY-----\nMIGHAgEA", None])
def test_an_authority_without_its_key_is_named(name: str | None, tmp_path: Path) -> None:
    make(tmp_path, "n1")
    key = tmp_path / "ca-key.pem"
    key.unlink() if name is None else key.write_text(name)
    result = make(tmp_path, "n2")
    assert result.code == 2
    assert f"{key} is not the key of {tmp_path}/ca.pem" in result.err
    assert not (tmp_path / "n2").exists()


def test_a_failed_write_leaves_no_partial_file(tmp_path, monkeypatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    assert make(tmp_path, "n1").code == 1
    assert make(tmp_path).code == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def names_of(result: Result) -> dict[str, list[str]]:
    """Return what --list printed: name -> serial number, days left and purpose."""
    assert (result.code, result.err) == (0, "")
    return {row[0]: row[1:] for row in (line.split() for line in result.out.splitlines())}


def verify(folder: Path, name: str) -> str:
    """Return what OpenSSL says of a certificate, with the list of the authority."""
    files = ("-CAfile", folder / "ca.pem", "-CRLfile", folder / "crl.pem", "-crl_check_all")
    command = ["openssl", "verify", *map(str, files), str(folder / f"{name}.pem")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return result.stdout + result.stderr


def test_the_list_has_serial_numbers_days_and_purposes(tmp_path: Path) -> None:
    make(tmp_path, "--days", "10", "--role", "Viewer")
    listed = names_of(make(tmp_path, "--list"))
    assert [*listed] == ["ca", "no-role", "server", "viewer"]
    for name, (serial, *days_and_purpose) in listed.items():
        certificate = load(tmp_path / f"{name}.pem")
        assert int(serial, 16) == certificate.serial_number
        assert days_and_purpose[:2] == ["9", "days"]
    purposes = {name: " ".join(row[3:]) for name, row in listed.items()}
    assert purposes == {
        "ca": "authority",
        "no-role": "no role",
        "server": "localhost, 127.0.0.1, ::1",
        "viewer": "role Viewer",
    }


def test_a_renewed_certificate_has_all_but_its_times_and_number(tmp_path: Path) -> None:
    make(tmp_path, "--days", "10")
    before = {name: load(tmp_path / f"{name}.pem") for name in ("ca", "server", "viewer")}
    keys = {path: path.read_bytes() for path in tmp_path.glob("*-key.pem")}
    assert make(tmp_path, "server", "ca", "--renew", "--days", "40").out.splitlines() == [
        str(tmp_path / "server.pem"),
        str(tmp_path / "ca.pem"),
    ]
    for name in ("server", "ca"):
        renewed, old = load(tmp_path / f"{name}.pem"), before[name]
        assert renewed.serial_number != old.serial_number
        assert [*renewed.extensions] == [*old.extensions]
        assert (renewed.subject, renewed.public_key()) == (old.subject, old.public_key())
        assert timedelta(days=39) < renewed.not_valid_after_utc - datetime.now(UTC)
        renewed.verify_directly_issued_by(load(tmp_path / "ca.pem"))
    assert load(tmp_path / "viewer.pem") == before["viewer"]
    assert make(tmp_path, "--renew").code == 0
    assert load(tmp_path / "viewer.pem") != before["viewer"]
    lifetime = load(tmp_path / "viewer.pem").not_valid_after_utc - datetime.now(UTC)
    assert timedelta(days=9) < lifetime < timedelta(days=10)
    assert {path: path.read_bytes() for path in keys} == keys


def test_revoked_certificates_are_refused_and_others_are_not(tmp_path: Path) -> None:
    """By name, and by the serial number in an audit trail, of a deleted certificate."""
    make(tmp_path)
    serial = f"{load(tmp_path / 'operator.pem').serial_number:x}"
    result = make(tmp_path, "--revoke", "viewer", "--revoke", serial)
    assert result.out.splitlines()[1:] == [f"{serial}: revoked", str(tmp_path / "crl.pem")]
    assert make(tmp_path, "--crl", "--days", "3").code == 0  # revoked certificates stay revoked
    for name in ("viewer", "operator"):
        assert "certificate revoked" in verify(tmp_path, name)
    for name in ("server", "engineer", "ca"):
        assert verify(tmp_path, name).endswith("OK\n")
    listed = names_of(make(tmp_path, "--list"))
    assert listed["viewer"][1] == listed["operator"][1] == "revoked"
    assert listed["crl"] == ["2", "days", "revocation", "list"]
    before = load(tmp_path / "viewer.pem")
    assert make(tmp_path, "--renew").code == 0
    assert "'viewer' is revoked" in make(tmp_path, "server", "viewer", "--renew").err
    assert load(tmp_path / "viewer.pem") == before


def test_machines_get_renewed_authorities_and_revocation_lists(tmp_path: Path) -> None:
    make(tmp_path, "n1", "n2")
    make(tmp_path, "--revoke", "n2")
    make(tmp_path, "ca", "--renew")
    for name in ("n1", "n2"):
        for file in ("ca.pem", "crl.pem"):
            assert (tmp_path / name / file).read_text() == (tmp_path / file).read_text()
    assert make(tmp_path, "n1", "--renew").out == f"{tmp_path}/n1/server.pem\n"


@each_case(
    ("words", "reason"),
    [
        (("--revoke", "nobody"), "'nobody' is no certificate in"),
        (("--revoke", "ca"), "an authority cannot revoke itself"),
        (("--revoke", "0"), "'0' is no certificate in"),
        (("nobody", "--renew"), "'nobody' is no certificate in"),
        (("--renew", "--days", "0"), "days must be in 1..36500"),
        (("--crl", "--days", "-1"), "days must be in 1..36500"),
        (("--list", "--crl"), "must be given one after the other"),
        (("server", "--list"), "--list takes neither MACHINE"),
    ],
)
def test_wrong_words_in_options_change_no_file(tmp_path: Path, words: tuple[str, ...], reason: str):
    if not (tmp_path / "ca.pem").exists():
        make(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    result = make(tmp_path, *words)
    assert result.code == 2
    assert reason in result.err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_files_of_others_are_left_alone(tmp_path: Path) -> None:
    make(tmp_path)
    make(tmp_path / "others")
    (tmp_path / "device.pem").write_bytes((tmp_path / "others" / "server.pem").read_bytes())
    assert "device" not in names_of(make(tmp_path, "--list"))
    (tmp_path / "crl.pem").write_bytes((tmp_path / "device.pem").read_bytes())
    assert "crl.pem: no revocation list in PEM format" in make(tmp_path, "--list").err
    make(tmp_path / "others", "--crl")
    (tmp_path / "crl.pem").write_bytes((tmp_path / "others" / "crl.pem").read_bytes())
    assert "is not signed by" in make(tmp_path, "--list").err


def test_a_token_is_new_and_only_its_owner_can_read_the_file(tmp_path: Path) -> None:
    path = tmp_path / "page.token"
    assert (run("token", path).code, run("token", path).code) == (0, 1)
    assert path.stat().st_mode & 0o777 == 0o600
    tokens = {path.read_text(), run("token").out, run("token").out}
    assert len(tokens) == 3
    assert all(TOKEN.fullmatch(token.removesuffix("\n")) for token in tokens)
