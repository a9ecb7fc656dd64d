"""URLs of brokers, databases and NATS servers, and the files with their secrets."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py.services.engine.connection import FileText, parse_servers
from libmodbus_py.services.fleet.files import load
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.other_servers import SecretFile, ServerUrl, server_url
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.secret_files import write_secret

PORTS = {"mqtt": 1883, "mqtts": 8883}

FLEET = """\
{output}
[[device]]
name = "a"
url = "tcp://127.0.0.1:9"
[[device.point]]
name = "p"
table = "holding_registers"
address = 0
"""


def influx(url: str) -> Influx:
    return Influx(url=url, database="d")


TAKEN: list[tuple[str, Callable[[str], Any], str]] = [
    ("mqtt", Mqtt, "password_file"),
    ("http", influx, "token_file"),
    ("nats", parse_servers, "NATS_CREDS"),
]
"""A scheme, what takes a URL with it, and the setting that names a file with the secret."""


def read(text: str, *, may_have_path: bool = False) -> ServerUrl:
    return server_url(
        "url", text, PORTS, example="mqtt://h", login="password_file", may_have_path=may_have_path
    )


@each_case(
    ("text", "server"),
    [
        ("mqtt://192.0.2.1", ServerUrl("mqtt", "192.0.2.1", 1883)),
        ("MQTTS://Broker.Example/", ServerUrl("mqtts", "broker.example", 8883)),
        ("mqtt://[2001:DB8::1]:7", ServerUrl("mqtt", "2001:db8::1", 7)),
    ],
)
def test_a_url_is_read(text: str, server: ServerUrl) -> None:
    assert read(text) == server


@each_case(
    "text",
    [
        *("http://h", "mqtt://", "mqtt:h", "mqtt://h/path", "mqtt://h?client_id=x", "mqtt://h#x"),
        *("mqtt://a b", "mqtt://h\n", "mqtt://bücher.example", "mqtt://[::1"),
        *("mqtt://h:0", "mqtt://h:65536", "mqtt://h:x"),
    ],
)
def test_a_wrong_url_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"url must be a URL such as|the port must be in 1..65535"):
        read(text)


@each_case(("scheme", "take", "setting"), TAKEN)
@each_case(
    "text",
    [
        *("{}://me:secret@h", "{}://secret@h", "{}://:secret@h:1", "{}://me:secret@h:0x"),
        *("{}://me:s,secret@h", "{}://h,{}://me:secret@h", "{}://me:p@secret@h", "{}:/me:secret@h"),
        *("x://me:secret@h", "me:secret@h", "{}://me:secret@[::1", "{}://me:se cret@h#secret"),
    ],
)
def test_a_login_in_a_url_is_refused_and_not_shown(scheme, take, setting, text) -> None:
    with pytest.raises(ValueError, match="must not contain a user or password: use ") as caught:
        take(text.format(scheme, scheme))
    assert setting in str(caught.value)
    assert "secret" not in str(caught.value)


@each_case(("scheme", "take", "setting"), TAKEN)
def test_a_token_in_a_query_is_refused_and_not_shown(scheme, take, setting) -> None:
    with pytest.raises(ValueError, match="must be a URL") as caught:
        take(f"{scheme}://h/?token=secret")
    assert "secret" not in str(caught.value)


@each_case("command", [("poll", "FILE", "--engine"), ("fleet", "status", "--engine")])
@each_case("url", ["nats://me:secret@h", "tls://h,nats://me:s,ecret@h", "nats://secret@h"])
def test_a_login_on_the_command_line(tmp_path: Path, command: tuple[str, ...], url: str) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET.format(output=""))
    words = [str(file) if word == "FILE" else word for word in command]
    result = run(*words, url)
    output = result.out + result.err
    assert result.code == 2
    assert "engine must not contain a user or password" in output
    assert "NATS_CREDS" in output
    assert "ecret" not in output


@each_case("value", ['"sesame"', "4711", '["sesame"]', '{ a = "sesame" }', "true"])
def test_a_password_in_a_fleet_file_is_refused_and_not_shown(tmp_path: Path, value: str) -> None:
    file = tmp_path / "fleet.toml"
    output = f'[output.mqtt]\nurl = "mqtt://h"\nuser = "u"\npassword = {value}'
    file.write_text(FLEET.format(output=output))
    with pytest.raises(ValueError, match="password must not be written in the file") as caught:
        load(file)
    assert "sesame" not in str(caught.value)
    assert "4711" not in str(caught.value)


SECRETS: list[Callable[[Path], Any]] = [SecretFile, lambda path: FileText("NATS_CREDS", str(path))]
"""What reads a file with a secret."""


@each_case("read_file", SECRETS)
@each_case("mode", [0o600, 0o400, 0o604, 0o644, 0o444])
def test_a_secret_is_used_only_if_others_cannot_read_it(tmp_path, read_file, mode) -> None:
    path = write_secret(tmp_path / "secret", "sesame")
    path.chmod(mode)
    if not mode & 0o077:
        read_file(path)
        return
    with pytest.raises(ValueError, match="all users of this machine can read this") as caught:
        read_file(path)
    assert str(path) in str(caught.value)
    assert "sesame" not in str(caught.value)


def test_a_secret_stays_the_former_one_when_others_can_read_the_new_file(tmp_path: Path) -> None:
    path = write_secret(tmp_path / "secret", "first\n")
    secret = SecretFile(path)
    write_secret(path, "second\n")
    assert secret.text == "second"
    path.write_text("third\n")
    path.chmod(0o644)
    assert secret.text == "second"


def test_secrets_of_one_file_compare_equal(tmp_path: Path) -> None:
    one, other = (write_secret(tmp_path / name, "the same\n") for name in ("one", "other"))
    assert SecretFile(one) == SecretFile(str(one))
    assert hash(SecretFile(one)) == hash(SecretFile(str(one)))
    assert SecretFile(one) != SecretFile(other)
    assert SecretFile(one) != str(one)
