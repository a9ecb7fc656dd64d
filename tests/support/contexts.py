"""Contexts that are libmodbus, for a URL; and slaves by hand, each in a thread."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

from libmodbus_py import FrameError, Mapping, ModbusConnectionError, RtuContext, TcpContext
from libmodbus_py.ports.endpoint import parse

from .interop import BAUDRATE, TIMEOUT, UNIT

AnyContext = TcpContext | RtuContext
Serve = Callable[[AnyContext, bytes], object]


def context_at(url: str, **options: Any) -> AnyContext:
    """Return a context for a unit at a URL; on a serial port at the rate of all tests."""
    end = parse(url)
    settings: dict[str, Any] = {"unit": UNIT, "timeout": TIMEOUT, **options}
    if end.is_serial:
        return RtuContext(end.path, BAUDRATE, **settings)
    return TcpContext(end.host, end.port, **settings)


def serve(slave: AnyContext, answer: Serve) -> None:
    """Answer requests as in C, until the slave is closed."""
    while True:
        try:
            if isinstance(slave, TcpContext):
                slave.accept()
            while True:
                with contextlib.suppress(FrameError):
                    if (request := slave.receive()) is not None:
                        answer(slave, request)
        except ModbusConnectionError:
            if slave._is_closed:
                return


@contextlib.contextmanager
def slave_by_hand(slave: AnyContext, answer: Serve | Mapping) -> Iterator[str]:
    """Run a slave in a thread, and yield the URL of a master."""
    if isinstance(answer, Mapping):
        mapping = answer

        def reply(slave: AnyContext, request: bytes) -> None:
            slave.reply(request, mapping)

        answer = reply
    if isinstance(slave, TcpContext):
        slave.listen()
    else:
        slave.connect()
    thread = threading.Thread(target=serve, args=(slave, answer), name="slave")
    thread.start()
    try:
        yield f"tcp://127.0.0.1:{slave.port}" if isinstance(slave, TcpContext) else ""
    finally:
        slave.close()
        thread.join()
