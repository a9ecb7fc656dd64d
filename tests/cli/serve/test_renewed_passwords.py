"""
SIGHUP: poll reads the password of a broker again, and goes on with the former if it cannot.
"""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

from tests.support.commands import Started
from tests.support.secret_files import write_secret

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
            write_secret(tmp_path / "secret", "first\n")
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
