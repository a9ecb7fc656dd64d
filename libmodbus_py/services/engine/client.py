"""
The client of nats-py, made to survive what servers and other clients send. Needs nats-py.

nats-py stops reading after an exception of its own, which a subject that is not UTF-8 is enough to
cause; it closes for good on any error of the server; and when it connects again, it sends the
password to a server that does not offer TLS.
"""

from __future__ import annotations

import asyncio
import json
import re
import ssl
from collections import UserString
from typing import Any

import nats.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.protocol.parser import PERMISSIONS_ERR, Parser

from ...protocol.logs import HarmlessLogger
from ...security.security import RenewedValue

logger: HarmlessLogger = HarmlessLogger(__name__)

# Bytes of a line, and of a message: nats-server allows no more.
LONGEST_LINE = 1 << 20
LARGEST_MESSAGE = 64 << 20

# What nats-server splits lines at. A subject may contain any other byte.
_SPACES = re.compile(rb"[ \t\r]+")


class SteadyClient(Client):
    """Reads on after malformed messages, and sends credentials over TLS only if that is wanted."""

    def __init__(self) -> None:
        super().__init__()
        self._ps = _Lines(self)

    async def _read_loop(self) -> None:
        await super()._read_loop()
        if self._reading_task is asyncio.current_task() and self.is_connected:
            # It has logged an exception.
            await self._process_op_err(nats.errors.ProtocolError())

    async def _process_err(self, err_msg: str) -> None:
        if PERMISSIONS_ERR in err_msg:
            await super()._process_err(err_msg)
            return
        error = nats.errors.Error(f"nats: {err_msg}")
        await self._error_cb(error)
        await self._process_op_err(error)

    async def _process_connect_init(self) -> None:
        try:
            await super()._process_connect_init()
        except BaseException as error:
            transport: Any = self._transport
            if transport is not None:
                transport.close()
            if not isinstance(error, Exception) or isinstance(error, nats.errors.Error | OSError):
                raise
            # Any other exception would end the attempts to connect again.
            raise nats.errors.Error(f"nats: {error or type(error).__name__}") from error

    @property
    def ssl_context(self) -> ssl.SSLContext:
        """The settings of TLS; read again from their files for each connection."""
        tls = self.options.get("tls")
        context: ssl.SSLContext = (
            tls.fresh() if isinstance(tls, RenewedValue) else super().ssl_context
        )
        return context

    def _connect_command(self) -> bytes:
        if "tls" in self.options and not self._server_info.get("tls_required"):
            raise nats.errors.Error("nats: the server does not support TLS; nothing was sent")
        if isinstance(self._nkeys_seed_str, UserString):
            self._setup_nkeys_seed_connect()  # the public key belongs to the seed
        command: bytes = super()._connect_command()
        return command

    async def _process_headers(self, headers: Any) -> dict[str, str] | None:
        try:
            return await super()._process_headers(headers)
        except Exception as error:
            logger.info("the headers of a message cannot be read: %s", error)
            return None

    def _build_message(
        self, sid: int, subject: bytes, reply: bytes, data: bytes, headers: dict[str, str] | None
    ) -> Msg:
        # No name of a fleet is spelled with replaced characters.
        subject, reply = (name.decode(errors="replace").encode() for name in (subject, reply))
        message: Msg = super()._build_message(sid, subject, reply, data, headers)
        return message


class _Lines(Parser):
    """
    Cuts received bytes into lines and messages. nats-py's expressions take a vertical tab or a form
    feed for a space: a subject with one is an error, or a message for another subscription.
    """

    def __init__(self, client: SteadyClient) -> None:
        super().__init__(client)
        self._client = client

    def reset(self) -> None:
        self._received = bytearray()
        # The message that is received now: subject, sid, reply, bytes of headers, bytes in all.
        self._message: tuple[bytes, int, bytes, int, int] | None = None

    async def parse(self, data: bytes = b"") -> None:
        buffer = self._received
        buffer += data
        while buffer is self._received:  # else the connection was lost meanwhile
            if self._message is not None:
                *_, size = self._message
                if len(buffer) < size + 2:
                    return
                await self._take(bytes(buffer[:size]))
            else:
                end = buffer.find(b"\n")
                if end > LONGEST_LINE or (end < 0 and len(buffer) > LONGEST_LINE):
                    raise nats.errors.ProtocolError
                if end < 0:
                    return
                line = bytes(buffer[:end])
                del buffer[: end + 1]
                await self._obey(line)

    async def _take(self, content: bytes) -> None:
        assert self._message is not None
        subject, sid, reply, header, size = self._message
        self._message = None
        del self._received[: size + 2]
        await self._client._process_msg(sid, subject, reply, content[header:], content[:header])

    async def _obey(self, line: bytes) -> None:
        operation, *words = [word for word in _SPACES.split(line) if word] or [b""]
        try:
            if operation == b"MSG":
                self._begin(words, 1)
            elif operation == b"HMSG":
                self._begin(words, 2)
            elif operation == b"PING":
                await self._client._process_ping()
            elif operation == b"PONG":
                await self._client._process_pong()
            elif operation == b"INFO":
                info = json.loads(line[len(operation) :])
                if not isinstance(info, dict):
                    raise ValueError(info)
                await self._client._process_info(info)
            elif operation == b"-ERR":
                text = line[len(operation) :].decode(errors="replace")
                await self._client._process_err(text.strip().lower())
            elif operation != b"+OK":
                raise nats.errors.ProtocolError
        except (ValueError, IndexError):
            raise nats.errors.ProtocolError from None

    def _begin(self, words: list[bytes], sizes: int) -> None:
        """Expect a message whose line ends with `sizes` numbers of bytes."""
        subject, sid, *replies = words[:-sizes]
        header, size = (0, *map(int, words[-sizes:]))[-2:]
        if not 0 <= header <= size <= LARGEST_MESSAGE or len(replies) > 1:
            raise ValueError(words)
        self._message = subject, int(sid), replies[0] if replies else b"", header, size
