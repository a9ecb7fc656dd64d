"""
A connection: connects, closes, and sends one request at a time.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

import modbus_connection as theirs

from ....client.asynchronous import AsyncClient
from ....client.reconnecting import State
from ....client.statistics import Statistics
from ....protocol.checks import seconds
from ....protocol.errors import ModbusConnectionError, ModbusError
from ....security.security import GivenContext
from .causes import not_connected, told
from .places import Params, url_of

__all__ = ["ClientConnection"]

Result = TypeVar("Result")

SHORTEST, LONGEST = 0.001, 86_400.0

# The number of consecutive timeouts that closes the connection: more than ever occur.
NEVER = 1_000_000

FILES = ("verify", "client_cert", "client_key")


class ClientConnection(theirs.ModbusConnection):
    """
    The base of `ModbusConnection`, which describes the arguments and attributes.

    The base class of modbus-connection decides when to connect, to wait and to close. A new
    `AsyncClient` is made for each connection.
    """

    _client: AsyncClient | None

    def __init__(
        self,
        params: Params,
        *,
        timeout: float | None = None,
        message_spacing: float | None = None,
        connect_delay: float | None = None,
    ) -> None:
        self.url: str = url_of(params)
        self.statistics: Statistics = Statistics()
        self.last_error: str = ""
        for name, value in (
            ("timeout", timeout),
            ("message_spacing", message_spacing),
            ("connect_delay", connect_delay),
        ):
            if value is not None:
                seconds(name, value, low=0, high=LONGEST)
        super().__init__(
            params,
            timeout=timeout,
            message_spacing=message_spacing,
            connect_delay=connect_delay,
        )
        self._later: set[asyncio.Task[None]] = set()

    # --- connecting ---------------------------------------------------------------------------

    async def _connect_client(self) -> AsyncClient:
        # After the connection is lost, the client is closed before it tries to connect again.
        client = AsyncClient(
            self.url,
            timeout=min(max(self._timeout, SHORTEST), LONGEST),  # units may require any, even 0
            timeouts_before_reconnect=NEVER,
            security=await self._security(),
            statistics=self.statistics,
            on_state=self._note_state,
        )
        try:
            return await client.__aenter__()  # closes the client if connecting fails
        except (ModbusConnectionError, RuntimeError) as error:
            made = not_connected(error)
            self.last_error = str(made)
            raise made from error

    async def _security(self) -> GivenContext | None:
        params = self._params
        if not isinstance(params, theirs.ModbusTlsParams):
            return None
        try:
            return GivenContext(await params.create_ssl_context())
        except OSError as error:  # SSLError is an OSError
            shown = ", ".join(f"{name}={getattr(params, name)!r}" for name in FILES)
            raise ValueError(f"cannot use {shown} for TLS: {error.strerror or error}") from None

    # --- ending -------------------------------------------------------------------------------

    async def _close_client(self, client: AsyncClient) -> None:
        try:
            await client.close()
        except RuntimeError as error:
            raise theirs.ModbusConnectionError(f"closing: {error}") from error

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        # States of earlier clients, and of a client that is still connecting, are ignored.
        client = self._client
        if state is State.DISCONNECTED and client is not None and client.state is state:
            self._on_connection_lost(error)

    def _on_connection_lost(self, error: Exception | None) -> None:
        """Note that the peer closed the connection, or that it failed."""
        if self._closed or self._client is None:
            return
        client, self._client = self._client, None
        self.last_error = f"connection lost: {error}"
        # The client is closed because it would connect again for requests that wait.
        self._run_later(client.close())
        # Called by the event loop, so that it handles the exceptions of callbacks.
        asyncio.get_running_loop().call_soon(self._lost_callbacks.fire)

    def close_later(self) -> None:
        """Close the connection permanently, without waiting until it is closed."""
        self._closed = True
        self._run_later(self.close())

    def _run_later(self, closing: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(closing)
        self._later.add(task)
        task.add_done_callback(self._later.discard)

    # --- options of units ----------------------------------------------------------------------

    def set_spacing(self, unit: int, duration: float) -> None:
        """Set the seconds without traffic before and after requests to a unit."""
        self._pacer.set_unit_spacing(unit, duration)

    def require_timeout(self, unit: int, duration: float | None) -> None:
        """Set the shortest timeout that a unit accepts, in seconds; None for any."""
        self._require_timeout(unit, duration)

    def require_connect_delay(self, unit: int, duration: float | None) -> None:
        """Set the shortest delay after connecting that a unit accepts, in seconds; None for any."""
        self._require_connect_delay(unit, duration)

    # --- requests -----------------------------------------------------------------------------

    async def carry_out(
        self, unit: int, operation: str, ask: Callable[[], Awaitable[Result]]
    ) -> Result:
        """
        Connect, wait until no other request is under way, and send a request.

        Args:
            unit: the unit, for the pauses between requests.
            operation: the name of the request in error messages.
            ask: sends the request and returns its result.

        Raises:
            modbus_connection.ModbusError: the request failed.
            TypeError, ValueError: an argument of the request is invalid.
        """
        try:
            await self.connect()
            async with self._pacer.paced(unit):
                await self.connect()  # again, if the connection was lost meanwhile
                return await self._ask(ask)
        except (ModbusError, theirs.ModbusError, RuntimeError) as error:
            made = told(error, operation)
            self.last_error = str(made)
            raise made from error

    def handle(self, unit: int) -> AsyncClient:
        """
        Return a handle of the current client for a unit.

        Raises:
            modbus_connection.ModbusConnectionError: there is no connection.
        """
        if self._client is None:
            raise theirs.ModbusConnectionError("the connection was lost before the request")
        return self._client.for_unit(unit)

    async def _ask(self, ask: Callable[[], Awaitable[Result]]) -> Result:
        try:
            return await ask()
        except ModbusError as error:
            if error.answers_another:
                await self._drop()
            raise

    async def _drop(self) -> None:
        """Close the connection before another request is sent over it."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(theirs.ModbusConnectionError):
                await self._close_client(client)
