"""A server on every transport of the real system, and the URL with which a client reaches it."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from libmodbus_py import Server
from libmodbus_py.tools.testing.wires import SerialWire

from .certificates import Pki, secured

TRANSPORTS = ["tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp", "tls", "rtu", "ascii"]


@contextmanager
def serving(transport: str, server: Server) -> Iterator[str]:
    """Serve in the background, and yield the URL of a client."""
    with ExitStack() as stack:
        if transport == "tls":
            folder = Path(stack.enter_context(TemporaryDirectory()))
            yield stack.enter_context(secured(server, Pki(folder)))
        elif transport in ("rtu", "ascii"):
            wire = stack.enter_context(SerialWire())
            stack.enter_context(server.background(f"{transport}://{wire.server}?baudrate=115200"))
            yield f"{transport}://{wire.client}?baudrate=115200"
        else:
            yield stack.enter_context(server.background(f"{transport}://127.0.0.1:0")).urls[0]
