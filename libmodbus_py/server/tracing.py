"""
Traces: functions that are called with every ADU that a server receives and sends.

The sessions report the frames that they have cut themselves, if there is a trace.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from typing import NoReturn

from ..device.hooks import timed
from ..ports.endpoint import Endpoint
from ..ports.trace import OnTraced, Trace, Traced, is_traced
from ..protocol.logs import HarmlessLogger
from .limits import ServerStatistics
from .service import ENDS, Channel, Later, MakeSession, Service, Session

__all__ = ["TracedService", "Traces"]

logger: HarmlessLogger = HarmlessLogger(__name__)


class Traces:
    """
    The functions that are called with ADUs; they can change, in any thread.

    Args:
        first: called with a `Traced`; or None.
    """

    def __init__(self, first: OnTraced | None) -> None:
        self._all: tuple[Harmless, ...] = () if first is None else (Harmless(first),)

    def __bool__(self) -> bool:
        return bool(self._all)

    def __call__(self, traced: Traced) -> None:
        for each in self._all:
            each(traced)

    @contextlib.contextmanager
    def with_another(self, callback: OnTraced) -> Iterator[None]:
        """Call another function, too, while the block runs."""
        another = Harmless(callback)
        self._all += (another,)
        try:
            yield
        finally:
            self._all = tuple(each for each in self._all if each is not another)


class TracedService:
    """
    A wrapper of a service whose sessions report their ADUs to a trace. See `Service`.

    Whether tracing is on is checked when a session is made.
    """

    def __init__(self, service: Service, traces: Traces) -> None:
        self._service = service
        self._traces = traces

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        make = self._service.sessions(endpoint, statistics, later)
        url, traces = str(endpoint), self._traces

        def made(channel: Channel) -> Session:
            is_on = is_traced(traces or None)
            channel.trace = Trace(url, traces, channel.address) if is_on else None
            return make(channel)

        return made


class Harmless:
    """
    A callback whose exceptions cost no client an answer.

    A failure is logged once, and a long duration once: a client must not be able to
    fill the log. SystemExit and KeyboardInterrupt leave the loop when this turn is over.
    """

    def __init__(self, callback: OnTraced) -> None:
        self._call = timed("trace", callback)
        self._has_failed = False

    def __call__(self, traced: Traced) -> None:
        try:
            self._call(traced)
        except ENDS as error:
            asyncio.get_running_loop().call_soon(_raise, error)
        except BaseException:
            if not self._has_failed:
                self._has_failed = True
                logger.exception("trace(%s) failed; this is logged once", traced)


def _raise(error: BaseException) -> NoReturn:
    raise error
