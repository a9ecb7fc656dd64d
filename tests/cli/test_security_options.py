"""TLS from the command line: what it takes, and what it says when that is wrong."""

import hashlib
import logging
import os
import pty
import subprocess
import sys
from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.commands import run
from tests.support.peers import mute_port

SECRET = "open sesame"


@pytest.fixture
def url(pki: Pki) -> Iterator[str]:
    """A server in this process, whose warnings are not those of a command."""
    server = Server(Device(Mapping(holding_registers={0: [555, 7]})), security=pki.server())
    log, silent = logging.getLogger("libmodbus_py.server"), logging.NullHandler()
    log.addHandler(silent)
    with server.background("tls://127.0.0.1:0") as running:
        yield running.urls[0]
    log.removeHandler(silent)


@pytest.fixture
def own(pki: Pki) -> list[str]:
    """The options of a client that may read and write."""
    files = pki.files(certificates.client())
    return ["--cert", str(files.cert), "--key", str(files.key), "--ca", str(pki.ca)]


def read(url: str, *options: str, **environment: str) -> str:
    """Read two registers; gives what was printed, once that was good."""
    result = run("read", url, "holding", "0", "2", *options, environment=environment)
    assert (result.code, result.err) == (0, "")
    return result.out


def fails(code: int, *arguments: str, **environment: str) -> str:
    """Return the one line of the error."""
    result = run(*arguments, environment=environment)
    assert result.code == code
    assert result.out == ""
    assert result.err.startswith("libmodbus-py: ")
    assert result.err.count("\n") == 1
    return result.err


GOOD = "0  555\n    1    7\n"


def test_a_client_with_a_certificate_reads(url: str, own: list[str], pki: Pki) -> None:
    assert read(url, *own).endswith(GOOD)
    assert read(url, *own, "--server-name", "localhost").endswith(GOOD)
    assert read(pki.url(url, certificates.client())).endswith(GOOD)


def test_one_of_several_pins_is_enough(url: str, own: list[str], pki: Pki) -> None:
    digest = hashlib.sha256(certificates.server().der).hexdigest()
    assert read(url, *own[:4], "--pin", str(pki.ca), "--pin", digest).endswith(GOOD)
    text = fails(1, "read", url, "holding", "0", *own[:4], "--pin", str(pki.ca))
    assert "it is none of the pins: 'CN=Test server'" in text
    assert digest in text


def test_a_password_comes_from_the_environment(url: str, pki: Pki) -> None:
    files = pki.files(certificates.client(), SECRET.encode())
    options = ["--cert", str(files.cert), "--key", str(files.key), "--ca", str(pki.ca)]
    arguments = [*options, "--password-env", "PLC_PASSWORD"]
    assert read(url, *arguments, PLC_PASSWORD=SECRET).endswith(GOOD)
    asking = ("read", url, "holding", "0")
    assert "is encrypted, and needs its password" in fails(2, *asking, *options)
    assert "no environment variable 'PLC_PASSWORD'" in fails(2, *asking, *arguments)
    text = fails(2, *asking, *arguments, PLC_PASSWORD="close sesame")
    assert "the password is another" in text
    assert "sesame" not in text


def test_a_command_without_a_terminal_asks_for_no_password(pki: Pki) -> None:
    """OpenSSL would ask the terminal."""
    files = pki.files(certificates.client(), SECRET.encode())
    master, slave = pty.openpty()
    arguments = ["read", "tls://127.0.0.1:1", "holding", "0", "--ca", str(pki.ca)]
    arguments += ["--cert", str(files.cert), "--key", str(files.key)]
    code = (
        "import fcntl, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
        "from libmodbus_py.cli.main import main; main(sys.argv[1:])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        stdin=slave,
        stdout=slave,
        stderr=subprocess.PIPE,
        text=True,
        timeout=30,
        start_new_session=True,
    )
    assert result.returncode == 2
    assert "is encrypted, and needs its password" in result.stderr
    os.set_blocking(master, False)
    with pytest.raises(BlockingIOError):
        os.read(master, 100)
    os.close(slave)
    os.close(master)


def test_an_option_overrides_the_url(own: list[str], url: str, pki: Pki) -> None:
    whole = pki.url(url, certificates.client())
    assert read(f"{whole}&server_name=other.example", "--server-name", "localhost").endswith(GOOD)
    assert read(f"{url}?ca=nowhere.pem", *own).endswith(GOOD)


def test_failures_are_reported_in_one_line(own: list[str], url: str) -> None:
    where = ("holding", "0", *own)
    with mute_port() as port:
        message = fails(1, "read", f"tls://127.0.0.1:{port}?timeout=0.3", *where)
    assert "127.0.0.1" in message
    message = fails(1, "read", url, *where, "--server-name", "other.example")
    assert "Hostname mismatch, certificate is not valid for 'other.example'" in message
    assert "SHA-256 " in message
