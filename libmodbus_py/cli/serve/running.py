"""
A command that serves, while it runs: where it listens and who can reach it, the message to systemd
that it serves, and SIGHUP, which reads files and certificates again, or ends it when its terminal
was closed.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence

from ...ports.endpoint import Endpoint, parse
from ...ports.hosts import is_loopback
from ...security.renewed import reload_all
from ...server.serving import Running, Serving
from ..output import complain, inform

__all__ = ["Hangup", "announcing", "is_secure", "noted", "notify_ready"]


def announcing(allowed: list[str] | None) -> Callable[[Running], None]:
    """
    Return a function that prints where a server listens, and notifies systemd.

    Args:
        allowed: the networks that the server serves; None for all.
    """

    def announce(running: Running) -> None:
        for url in running.urls:
            inform(f"listening on {url}")
        unguarded = [] if allowed else [url for url in running.urls if _is_open(parse(url))]
        if unguarded:
            complain(
                f"anyone who can reach {', '.join(unguarded)} can read and write; --allow NETWORK,"
                " or tls:// with certificates, restricts access",
                "warning",
            )
        notify_ready()

    return announce


def _is_open(endpoint: Endpoint) -> bool:
    """Return True if other machines can reach an endpoint that asks for no certificate."""
    return not (endpoint.has_path or endpoint.is_secure or is_loopback(endpoint.host))


def notify_ready() -> None:
    """
    Notify the service manager that the command serves, with one datagram as sd_notify(3) describes;
    do nothing without one.
    """
    place = os.environ.get("NOTIFY_SOCKET", "")
    if not place.startswith(("/", "@")):
        return
    address = "\0" + place[1:] if place.startswith("@") else place
    # A manager that is gone is not a reason to stop serving.
    with (
        contextlib.suppress(OSError),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
    ):
        sender.sendto(b"READY=1", address)


def is_secure(urls: Iterable[str]) -> bool:
    """Return True if one of these endpoints has certificates."""
    return any(parse(url).is_secure for url in urls)


class Hangup:
    """
    SIGHUP, from the start of a command on.

    An administrator sends it after a change of a file, and the system when a terminal is closed. In
    the second case the program ends as on SIGTERM; not under nohup, or without a terminal.

    Attributes:
        came: True if the signal came while the command started.
    """

    def __init__(self) -> None:
        self.came: bool = False
        self._before = signal.getsignal(signal.SIGHUP)
        self._can_close = _has_terminal() and self._before is not signal.SIG_IGN
        is_main = threading.current_thread() is threading.main_thread()
        self._is_noted = is_main and self._before not in (signal.SIG_IGN, None)
        if self._is_noted:
            signal.signal(signal.SIGHUP, self._note)

    def _note(self, number: int, frame: object) -> None:
        self.came = True

    def give_back(self) -> None:
        """Let the signal have its earlier effect again."""
        if self._is_noted:
            self._is_noted = False
            signal.signal(signal.SIGHUP, self._before)

    def unless_closed(
        self,
        tell: Callable[[str], object],
        *read_again: Callable[[], str],
        read_later: Callable[[Sequence[str]], object] | None = None,
    ) -> Callable[[], None]:
        """
        Return a function for the signal, each of which is answered by one line.

        Args:
            tell: called with the line.
            read_again: each reads a file again, before the certificates and passwords are read
                again, and returns what the line says of it.
            read_later: reads a file again without blocking, and is called with what the line says
                of the others, in place of `tell`.
        """

        def hung_up() -> None:
            if self._can_close and not _has_terminal():
                signal.raise_signal(signal.SIGTERM)
            else:
                said = [*(each() for each in read_again), *reload_all()]
                if read_later is not None:
                    read_later(said)
                elif said:
                    tell("; ".join(said))

        return hung_up

    def serve_forever(
        self,
        server: Serving,
        urls: Sequence[str],
        begin: Callable[[Running], object],
        read_again: Callable[[], object] | None,
    ) -> None:
        """
        Serve until a signal; one that came while the command started counts from then on.

        Args:
            begin: called once, when all endpoints are open.
            read_again: for SIGHUP; None if it ends the program.
        """
        if read_again is None:
            self.give_back()
            if self.came:
                signal.raise_signal(signal.SIGHUP)

        def begun(running: Running) -> None:
            begin(running)
            if self.came and read_again is not None:
                read_again()

        server.serve_forever(*urls, on_listening=begun, on_hangup=read_again)


@contextlib.contextmanager
def noted() -> Iterator[Hangup]:
    """Note SIGHUP while a command starts, instead of ending the program."""
    hangup = Hangup()
    try:
        yield hangup
    finally:
        hangup.give_back()


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError:
        return False
    return True
