"""Clients, while the n-th call of the system fails."""

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from libmodbus_py import AsyncClient, Client, ModbusError, ModbusTimeoutError
from libmodbus_py.protocol import framing
from tests.faults.injecting import Scenario, Trial, eventually, try_faults
from tests.faults.test_servers import server
from tests.support.certificates import Pki, secured
from tests.support.names import resolve
from tests.support.peers import FakeServer, FakeUnit, echo

PART = ("client", "ports", "security")

# Where a fault takes an answer away, or a line must be silent after it, somebody waits so long.
TIMEOUT = 0.05
PATIENT = 10.0

# The number of attempts until all must be well again.
TRIES = 200

# All ask for the same: where a busy machine answers later than that, it is an answer to the next.
ADDRESS = 7

Place = Callable[[Path], contextlib.AbstractContextManager[str]]


def each_echoed(requests: bytes) -> list[bytes]:
    """Return frames that may arrive together as separate ones."""
    return [echo(requests[at : at + 12]) for at in range(0, len(requests), 12)]


def on_line(request: bytes) -> list[bytes]:
    body = request[:1] + b"\x03\x02" + request[2:4]
    return [body + framing.crc16(body).to_bytes(2, "little")]


@contextlib.contextmanager
def tcp(folder: Path) -> Iterator[str]:
    with FakeServer(each_echoed) as server:
        yield server.url


@contextlib.contextmanager
def host_name(folder: Path) -> Iterator[str]:
    with tcp(folder) as url, pytest.MonkeyPatch.context() as patched:
        resolve(patched, "device.example")
        yield url.replace("127.0.0.1", "device.example")


@contextlib.contextmanager
def rtu_over_tcp(folder: Path) -> Iterator[str]:
    with FakeServer(on_line) as server:
        yield f"rtu+tcp://127.0.0.1:{server.port}"


@contextlib.contextmanager
def udp(folder: Path) -> Iterator[str]:
    with server().background("udp://127.0.0.1:0") as running:
        yield running.urls[0]


@contextlib.contextmanager
def tls(folder: Path) -> Iterator[str]:
    with secured(server(), Pki(folder)) as url:
        yield url


@contextlib.contextmanager
def rtu(folder: Path) -> Iterator[str]:
    with FakeUnit(on_line) as unit:
        yield f"rtu://{unit.path}?baudrate=115200"


PLACES: dict[str, Place] = {
    "tcp": tcp,
    "named": host_name,
    "rtu+tcp": rtu_over_tcp,
    "udp": udp,
    "tls": tls,
    "rtu": rtu,
}


def is_answered(client: Client) -> bool:
    with contextlib.suppress(ModbusError):
        return client.read_holding_registers(ADDRESS, 1) == [ADDRESS]
    return False


def patience(url: str) -> float:
    return PATIENT if url.startswith(("tcp", "tls")) else TIMEOUT


def blocking(url: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        client: Client | None = None
        with trial.faults(ModbusTimeoutError):
            client = Client(url, timeout=patience(url))
            client.read_holding_registers(ADDRESS, 1)
            client.read_holding_registers(ADDRESS, 1)
        if client is None:
            return
        try:
            assert eventually(lambda: is_answered(client))
        finally:
            with trial.faults():
                client.close()
            client.close()

    return scenario


def unblocked(url: str) -> Scenario:
    async def run(trial: Trial) -> None:
        client = AsyncClient(url, timeout=patience(url), max_pause=0)
        try:
            with trial.faults(ModbusTimeoutError):
                await asyncio.gather(*(client.read_holding_registers(ADDRESS, 1) for _ in range(2)))
            for _ in range(TRIES):
                with contextlib.suppress(ModbusError):
                    assert await client.read_holding_registers(ADDRESS, 1) == [ADDRESS]
                    break
            else:
                raise AssertionError("it is not answered any more")
        finally:
            with trial.faults():
                await client.close()
            await client.close()

    return lambda trial: asyncio.run(run(trial))


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["blocking", "asyncio"])
def test_a_client_reports_failures_and_continues(kind: str, place: str, tmp_path: Path) -> None:
    with PLACES[place](tmp_path) as url:
        scenario = unblocked(url) if kind == "asyncio" else blocking(url)
        try_faults(scenario, *PART)
