"""
SIGHUP: commands that serve show a renewed certificate, follow a revocation list, use new passwords.
"""

from __future__ import annotations

import asyncio
import signal
import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, ModbusConnectionError, Server, TlsContext
from tests.cli.serving import FLEET_OF_ONE
from tests.support import certificates
from tests.support.certificates import Papers
from tests.support.commands import Started
from tests.support.peers import until


@pytest.fixture(params=["serve", "gateway"])
def command(request: pytest.FixtureRequest) -> Iterator[list[str]]:
    """A command without a file of its own."""
    if request.param == "serve":
        yield ["serve"]
        return
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running:
        yield ["gateway", "--to", running.urls[0]]


def test_files_of_certificates_are_read_again_on_hangup(
    command: list[str], papers: Papers, tmp_path: Path
) -> None:
    files = papers.files(certificates.server())
    crl = tmp_path / "crl.pem"
    crl.write_bytes(certificates.revocation_list())
    own = ["--cert", files.cert, "--key", files.key, "--ca", papers.ca, "--crl", crl]
    name, *rest = command
    with Started(name, "tls://127.0.0.1:0", *rest, *map(str, own)) as process:
        url = process.stdout.readline().removeprefix("listening on ").rstrip("\n")
        port = int(url.rpartition(":")[2])
        with TlsContext("127.0.0.1", port, security=papers.client()) as plc:
            plc.read_holding_registers(0, 1)

        renewed = certificates.server(days=30)
        files.cert.write_bytes(renewed.pem)
        process.send_signal(signal.SIGHUP)
        assert process.stderr.readline() == (
            f"the former content is used: key {str(files.key)!r}: not the key of the certificate\n"
        )
        files.key.write_bytes(renewed.key_pem())
        crl.write_bytes(certificates.revocation_list(certificates.client("Operator")))
        process.send_signal(signal.SIGHUP)
        assert process.stderr.readline() == "certificates and passwords: read again\n"
        until(lambda: shown(port) == renewed.der)
        with pytest.raises(ModbusConnectionError, match="refused our certificate"):
            TlsContext("127.0.0.1", port, security=papers.client()).read_holding_registers(0, 1)
        with TlsContext("127.0.0.1", port, security=papers.client("Viewer")) as plc:
            plc.read_holding_registers(0, 1)
        process.terminate()
        assert process.wait() == 0


FILES = {
    "serve": (["tls://127.0.0.1:0", "--device"], "[[unit]]\nid = 1\n", "1 unit"),
    "gateway": (
        ["tls://127.0.0.1:0", "--config"],
        '[[route]]\nto = "tcp://127.0.0.1:1"\n',
        "1 route",
    ),
    "poll": ([], FLEET_OF_ONE, "1 device"),
}


@pytest.mark.parametrize("name", FILES)
def test_one_line_says_what_became_of_all_files(name: str, papers: Papers, tmp_path: Path) -> None:
    files, file, trail = papers.files(certificates.server()), tmp_path / "file", tmp_path / "audit"
    arguments, text, what = FILES[name]
    own = {"cert": files.cert, "key": files.key, "ca": papers.ca}
    query = "&".join(f"{key}={value}" for key, value in own.items())
    file.write_text(text.format(url=f"tls://127.0.0.1:1?{query}"))
    options = [] if name == "poll" else [f"--{key}={value}" for key, value in own.items()]
    audit = [] if name == "poll" else ["--audit", str(trail)]
    with Started(name, *arguments, file, *options, *audit) as process:
        process.stdout.readline()  # where it listens, or the first poll
        files.key.write_bytes(certificates.server(days=30).key_pem())
        lines = []
        for _ in range(2):
            process.send_signal(signal.SIGHUP)
            lines.append(next(line for line in process.stderr if str(files.key) in line))
        process.terminate()
        lines += process.stderr
        assert process.wait() == 0
    opened = f"{trail}: opened again; " if audit else ""
    bad_key = f"the former content is used: key {str(files.key)!r}: not the key of the certificate"
    expected = {f"{file}: read again, {what}: no change", bad_key} | {opened[:-2]} - {""}
    assert [set(line.rstrip("\n").split("; ")) for line in lines[:2]] == [expected] * 2
    assert not [line for line in lines[2:] if "read again" in line or "former" in line]


def shown(port: int) -> bytes:
    return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate(("127.0.0.1", port)))


# --- passwords ----------------------------------------------------------------------


FLEET = """\
[output.mqtt]
url = "mqtt://127.0.0.1:{port}"
user = "poller"
password_file = "secret"
[[device]]
name = "a"
url = "tcp://127.0.0.1:{port}"
map = "map.csv"
interval = 60
"""


class Broker:
    """A server that notes the password of each CONNECT packet, and refuses it."""

    def __init__(self) -> None:
        self.passwords: asyncio.Queue[str] = asyncio.Queue()

    async def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        packet = await reader.read(1000)
        if packet[:1] == b"\x10":  # MQTT 3.1.1, 3.1: the password is the last field
            after_user = packet[packet.index(b"poller") + len(b"poller") :]
            self.passwords.put_nowait(after_user[2:].decode())
            writer.write(b"\x20\x02\x00\x05")  # not authorized
        writer.close()


def test_a_new_password_is_used_and_one_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    async def go() -> None:
        broker = Broker()
        async with await asyncio.start_server(broker.accept, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            (tmp_path / "map.csv").write_text("name,table,address,type\npower,holding,0,uint16\n")
            (tmp_path / "secret").touch(mode=0o600)
            (tmp_path / "secret").write_text("first\n")
            (tmp_path / "fleet.toml").write_text(FLEET.format(port=port))
            with Started("poll", str(tmp_path / "fleet.toml"), "--json") as process:
                assert await broker.passwords.get() == "first"
                (tmp_path / "secret").write_text("second\n")
                while await broker.passwords.get() != "second":
                    pass
                (tmp_path / "secret").unlink()
                process.send_signal(signal.SIGHUP)
                told = await asyncio.to_thread(line_with, process, "the former content is used: ")
                assert str(tmp_path / "secret") in told
                assert await broker.passwords.get() == "second"
                process.terminate()
                assert await asyncio.to_thread(process.wait) == 0

    asyncio.run(go())


def line_with(process: Started, words: str) -> str:
    """Return the next line of the standard error with these words."""
    while words not in (line := process.stderr.readline()):
        assert line, "the program ended"
    return line
