"""What is read from files again: at SIGHUP, and for each connection to a broker."""

import asyncio
import gc
import logging
import ssl
from pathlib import Path

import pytest

from libmodbus_py.security.security import RenewedValue, reload_all
from libmodbus_py.services.engine.connection import EngineError, FileText, _identity, _trust
from libmodbus_py.services.fleet.files import load
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.other_servers import SecretFile, text_of
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.secret_files import write_secret

CREDENTIALS = """\
-----BEGIN NATS USER JWT-----
{}
------END NATS USER JWT------
-----BEGIN USER NKEY SEED-----
SUAOY
------END USER NKEY SEED------
"""


def authorities(context: object) -> list[bytes]:
    """Return the authorities that a context trusts, in DER."""
    assert isinstance(context, ssl.SSLContext)
    return context.get_ca_certs(binary_form=True)


def mistakes(about: Path) -> list[str]:
    """Return what a reload reports about a file."""
    gc.collect()
    return [line for line in reload_all() if str(about) in line]


@pytest.fixture
def ca(pki: Pki) -> Path:
    return pki.ca


def test_a_value_stays_until_its_file_is_valid_again(tmp_path, caplog) -> None:
    path = tmp_path / "number"
    path.write_text("1")
    renewed = RenewedValue(lambda: int(path.read_text()))
    path.write_text("2")
    assert renewed.value == 1
    reload_all()
    assert renewed.value == 2
    path.write_text("two")
    messages = [line for line in reload_all() if "'two'" in line]
    assert messages == ["the former content is used: invalid literal for int() with base 10: 'two'"]
    assert [renewed.fresh(), renewed.fresh()] == [2, 2]
    path.unlink()
    assert renewed.fresh() == 2
    path.write_text("3")
    assert renewed.fresh() == 3
    assert [record.levelno for record in caplog.records] == [
        logging.WARNING
    ] * 2  # once for each reason


def test_values_without_users_are_not_read_again(tmp_path: Path) -> None:
    path = tmp_path / "password"
    write_secret(path, "secret")
    first, second = SecretFile(path), SecretFile(path)
    assert first == second
    del second
    path.unlink()
    assert len(mistakes(path)) == 1
    del first
    assert mistakes(path) == []


def test_a_password_file_of_mqtt_is_read_again(tmp_path: Path) -> None:
    (tmp_path / "map.csv").write_text("name,table,address,type\npower,holding,0,uint16\n")
    write_secret(tmp_path / "secret", "first\n")
    (tmp_path / "fleet.toml").write_text(
        "[output.mqtt]\nurl = 'mqtt://192.0.2.1'\nuser = 'u'\npassword_file = 'secret'\n"
        "[[device]]\nname = 'a'\nurl = 'tcp://192.0.2.2'\nmap = 'map.csv'\n"
    )
    file = load(tmp_path / "fleet.toml")
    password = file.outputs[0][1]["password"]
    assert asyncio.run(text_of(password)) == "first"
    (tmp_path / "secret").write_text("second")
    assert asyncio.run(text_of(password)) == "second"
    assert load(tmp_path / "fleet.toml").outputs == file.outputs
    (tmp_path / "secret").unlink()
    assert asyncio.run(text_of(password)) == "second"
    assert len(mistakes(tmp_path / "secret")) == 1
    assert "second" not in repr(file.outputs)


def test_the_authorities_of_mqtt_are_read_again(ca: Path) -> None:
    output = Mqtt("mqtts://192.0.2.1", ca=str(ca))
    before = authorities(asyncio.run(output._connection._trust.context()))
    ca.write_bytes(certificates.foreign_authority().pem)
    after = authorities(asyncio.run(output._connection._trust.context()))
    assert before != after
    ca.write_text("in the midst of being written")
    assert authorities(asyncio.run(output._connection._trust.context())) == after
    assert len(mistakes(ca)) == 1


def test_the_authorities_of_nats_are_read_again(ca: Path) -> None:
    from libmodbus_py.services.engine.client import SteadyClient

    client = SteadyClient()
    client.options |= _trust(["nats://192.0.2.1"], {"NATS_CA": str(ca)})
    before = authorities(client.ssl_context)
    ca.write_bytes(certificates.foreign_authority().pem)
    after = authorities(client.ssl_context)
    assert before != after
    ca.unlink()
    assert authorities(client.ssl_context) == after
    assert len(mistakes(ca)) == 1


def test_credentials_of_nats_are_read_again(tmp_path, monkeypatch) -> None:
    """As nats-py reads them, which reads a file without credentials for ever."""
    from libmodbus_py.services.engine import connection
    from libmodbus_py.services.engine.client import SteadyClient

    monkeypatch.setattr(connection, "find_spec", lambda name: name)
    path = tmp_path / "user.creds"
    write_secret(path, CREDENTIALS.format("first"))
    credentials = _identity({"NATS_CREDS": str(path)})["user_credentials"]
    client = SteadyClient()
    assert client._read_creds_user_jwt(credentials) == b"first"
    path.write_text(CREDENTIALS.format("second"))
    assert client._read_creds_user_jwt(credentials) == b"second"
    path.write_text("")
    assert client._read_creds_user_jwt(credentials) == b"second"
    assert client._read_creds_user_nkey(credentials) == b"SUAOY"
    (message,) = mistakes(path)
    assert message.endswith("user.creds: contains no 'BEGIN NATS USER JWT'")


@pytest.mark.parametrize("name", ["NATS_CREDS", "NATS_NKEY"])
def test_a_file_without_credentials_is_refused_at_the_start(tmp_path, monkeypatch, name) -> None:
    from libmodbus_py.services.engine import connection

    monkeypatch.setattr(connection, "find_spec", lambda name: name)
    path = write_secret(tmp_path / "empty", "")
    with pytest.raises(EngineError, match=f"^{name}: .*empty: contains no "):
        _identity({name: str(path)})


def test_a_seed_can_be_stripped_and_encoded_as_nats_py_does(tmp_path: Path) -> None:
    path = write_secret(tmp_path / "seed", "SUAOY\n")
    assert bytearray(FileText("NATS_NKEY", str(path), "SU").strip().encode()) == b"SUAOY"
