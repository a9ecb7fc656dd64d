"""Tests of the asyncio client that run in one event loop, with a peer, in simulated time."""

from collections.abc import Awaitable, Callable
from typing import Any

from libmodbus_py import AsyncClient
from tests.simulation.network import Network
from tests.simulation.scripted import OnRequest, Scripted


def run_peer(
    on_request: OnRequest,
    main: Callable[[Scripted], Awaitable[object]],
    url: str = "tcp://10.0.0.1",
) -> None:
    """Run a coroutine function with a peer."""
    network = Network()
    peer = Scripted(network, url, on_request)

    async def run() -> None:
        await main(peer)

    network.run(run)


def run_client(
    on_request: OnRequest,
    use: Callable[[AsyncClient, Scripted], Awaitable[object]],
    url: str = "tcp://10.0.0.1",
    **options: Any,
) -> None:
    """Run a coroutine function with a client, and the peer to which it is connected."""

    async def main(peer: Scripted) -> None:
        async with AsyncClient(peer.url, **options) as plc:
            await use(plc, peer)

    run_peer(on_request, main, url)
