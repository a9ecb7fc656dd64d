"""A server on a LAN, and the requests that tests of its limits send there."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any, Self

from libmodbus_py import Access, Device, Fault, Gateway, Mapping, Route, Server, framing
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server.limits import Limits
from tests.simulation.lan import Lan, LanClient
from tests.support import certificates
from tests.support.attacks import READ_ONE, adu
from tests.support.certificates import lasting_pki
from tests.support.tls import VERSIONS, TlsClient, context

ANSWER_ONE = bytes.fromhex("03 02 0000")
ONE_ANSWER = len(adu(ANSWER_ONE))
ANSWER_MOST = bytes([3, 250]) + bytes(250)
MOST_ANSWER = len(adu(ANSWER_MOST))

KINDS = ["plain", "hooked", "faulty"]
"""Most of the server's ways to answer: in C by the chunk, through hooks, with faults."""

OVER_TCP = [*KINDS, "tls"]  # the kinds of servers with connections: the same, and one behind TLS

NEVER = Fault("no_answer", function=100)
"""Happens to nobody here, but makes every answer go the way of faults."""

OTHER = "10.255.0.2"  # the address of a client that is another one than the usual

# What a request and its answer take on the network in memory, at most.
ROUND_TRIP = 0.001


class SealedClient:
    """
    A client over TLS, with the face of a `LanClient`; a server that closes must say goodbye.

    TLS 1.2, where nothing comes between the handshake and the first answer.
    """

    def __init__(self, lan: Lan, port: int, source: str | None) -> None:
        context_ = context(lasting_pki(), certificates.client(), VERSIONS["1.2"])
        self._client = TlsClient(port, context_, source=source or "", lan=lan)
        self._talker: LanClient = self._client.socket
        self._client.handshake()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getattr__(self, name: str) -> Any:
        """Return what does not look at bytes: `close`, `reset`, `shutdown`, `has_input`, `end`."""
        return getattr(self._talker, name)

    def sendall(self, data: bytes) -> None:
        """Send a record of each 16 KiB."""
        self._client.send(*(data[at : at + 16_384] for at in range(0, len(data), 16_384)))

    def receive(self, size: int) -> bytes:
        """Return so many bytes; fewer if the server said goodbye before."""
        return self._client.receive(size)

    def is_closed(self) -> bool:
        """Wait for the goodbye; return False if bytes come in place of it."""
        return self._client.read(1) == b""


class LanServer:
    """
    A server on a LAN. `statistics`: what it counts; `url`: where it listens; `place` the same as
    a host and a port.
    """

    def __init__(self, lan: Lan, server: Server, url: str) -> None:
        self.statistics = server.statistics
        self.url = url
        self.place = (parse(url).host, parse(url).port)
        self._lan = lan

    def connect(self, source: str | None = None) -> Any:
        """Return a `LanClient`, or a `SealedClient`."""
        endpoint = parse(self.url)
        if endpoint.scheme == "tls":
            return SealedClient(self._lan, endpoint.port, source)
        return self._lan.client(self.url, source)

    def refuses(self, source: str | None = None) -> bool:
        """Return True if a new connection is closed before it says anything."""
        return self._lan.client(self.url, source).is_closed()

    def counts(self, **numbers: int) -> bool:
        """Assert what it has counted of that, when all that was sent has arrived."""
        self._lan.pass_time(ROUND_TRIP)
        counted = asdict(self.statistics)
        values = {name: counted[name] for name in numbers}
        assert values == numbers, f"{values} in place of {numbers}"
        return True


@contextmanager
def server_on(
    lan: Lan, kind: str = "plain", scheme: str = "tcp", *, faults: Any = None, **limits: Any
) -> Iterator[LanServer]:
    mapping = Mapping(holding_registers=125)
    device = Device(mapping, before_read=(lambda access: None) if kind == "hooked" else None)
    faults = {None: [NEVER]} if kind == "faulty" else faults
    url = f"{scheme}://10.0.0.1:0"
    security = None
    if kind == "tls":
        url, security = "tls://127.0.0.1:0", lasting_pki().server()
    server = Server({17: device}, faults=faults, limits=Limits(**limits), security=security)
    with server.background(url) as running:
        yield LanServer(lan, server, running.urls[0])


@contextmanager
def unit_one(
    url: str, *, is_gateway: bool = False, **settings: Any
) -> Iterator[tuple[Any, list[Access]]]:
    """
    Serve unit 1 from a device, or through a gateway on the LAN. `settings`: of the server. Yields
    what serves there, and all that is written, oldest first.
    """
    writes: list[Access] = []
    device = Device(Mapping(holding_registers=4, coils=4), before_write=writes.append)
    server = Server({1: device}, **settings)
    if not is_gateway:
        with server.background(url):
            yield server, writes
        return
    gateway = Gateway([Route("tcp://10.0.0.2:502", units="1")])
    with server.background("tcp://10.0.0.2:502"), gateway.background(url):
        yield gateway, writes


def ask(client: LanClient | SealedClient, transaction: int = 1) -> None:
    """Send a request, and take its answer."""
    client.sendall(adu(READ_ONE, transaction))
    assert client.receive(ONE_ANSWER) == adu(ANSWER_ONE, transaction)


def rtu(pdu: bytes, unit: int = 17) -> bytes:
    return framing.RtuFramer("server").encode(framing.Frame(unit, pdu))
