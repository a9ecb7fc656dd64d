"""
A connection: made, lost, closed, and one request at a time over it.
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
from ....security.given import GivenContext
from .causes import not_connected, told
from .places import Params, url_of

__all__ = ["ClientConnection"]

Result = TypeVar("Result")

SHORTEST, LONGEST = 0.001, 86_400.0

# A timeout keeps the link.
NEVER = 1_000_000

FILES = ("verify", "client_cert", "client_key")


class ClientConnection(theirs.ModbusConnection):
    """
    See `ModbusConnection`.

    The base connects, waits and ends as its contract says; a client of ours lives as long as one
    link does.
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
        client = AsyncClient(
            self.url,
            timeout=min(max(self._timeout, SHORTEST), LONGEST),  # units may ask for any, even 0
            max_pause=0,
            timeouts_before_reconnect=NEVER,
            security=await self._security(),
            statistics=self.statistics,
            on_state=self._note_state,
        )
        try:
            return await client.__aenter__()  # which closes it if that fails
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
        except OSError as error:  # which SSLError is, too
            shown = ", ".join(f"{name}={getattr(params, name)!r}" for name in FILES)
            raise ValueError(f"no TLS with {shown}: {error.strerror or error}") from None

    # --- ending -------------------------------------------------------------------------------

    async def _close_client(self, client: AsyncClient) -> None:
        try:
            await client.close()
        except RuntimeError as error:
            raise theirs.ModbusConnectionError(f"closing: {error}") from error

    def _note_state(self, state: State, error: ModbusError | None) -> None:
        # Clients that are no longer, or not yet, the link have a state of their own.
        client = self._client
        if state is State.DISCONNECTED and client is not None and client.state is state:
            self._on_connection_lost(error)

    def _on_connection_lost(self, error: Exception | None) -> None:
        """The other side, or the line, took it away."""
        if self._closed or self._client is None:
            return
        client, self._client = self._client, None
        self.last_error = f"connection lost: {error}"
        # It would connect again for whoever still waits in it.
        self._run_later(client.close())
        # Not from here: what a callback raises is its loop's affair, not our client's.
        asyncio.get_running_loop().call_soon(self._lost_callbacks.fire)

    def close_later(self) -> None:
        """Close it for good, and wait neither for that nor for an attempt to connect."""
        self._closed = True
        self._run_later(self.close())

    def _run_later(self, closing: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(closing)
        self._later.add(task)
        task.add_done_callback(self._later.discard)

    # --- what units want of it -----------------------------------------------------------------

    def set_spacing(self, unit: int, duration: float) -> None:
        """Seconds of quiet before and after requests to a unit."""
        self._pacer.set_unit_spacing(unit, duration)

    def require_timeout(self, unit: int, duration: float | None) -> None:
        """Seconds at least; None for any."""
        self._require_timeout(unit, duration)

    def require_connect_delay(self, unit: int, duration: float | None) -> None:
        """Seconds at least; None for any."""
        self._require_connect_delay(unit, duration)

    # --- asking -------------------------------------------------------------------------------

    async def carry_out(
        self, unit: int, operation: str, ask: Callable[[], Awaitable[Result]]
    ) -> Result:
        """
        Connect, wait for one's turn, and ask.

        Args:
            operation: what is asked, for errors.

        Raises:
            modbus_connection.ModbusError: it did not work.
            TypeError, ValueError: it cannot be asked.
        """
        try:
            await self.connect()
            async with self._pacer.paced(unit):
                await self.connect()  # again, if it was dropped meanwhile
                return await self._ask(ask)
        except (ModbusError, theirs.ModbusError, RuntimeError) as error:
            made = told(error, operation)
            self.last_error = str(made)
            raise made from error

    def handle(self, unit: int) -> AsyncClient:
        """
        Give the client of now, for the unit.

        Raises:
            modbus_connection.ModbusConnectionError: there is none.
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
        """Drop the link before anybody else asks over it."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(theirs.ModbusConnectionError):
                await self._close_client(client)
