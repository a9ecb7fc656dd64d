"""
The surroundings of a command that serves, until the signal that ends it: limits for clients, the
log, the audit trail, metrics, a page, the message to systemd that it serves, and SIGHUP.

SIGHUP waits while a command starts. Then it is answered by one line, which says what became of
files, certificates and passwords that were read again. When its terminal was closed, the command
ends as on SIGTERM.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self

from ...ports.endpoint import parse
from ...ports.hosts import is_loopback
from ...protocol.logs import HarmlessLogger, log_reload
from ...protocol.mistakes import Problem
from ...security.security import reload_all
from ...server.audit import Audit, AuditFile
from ...server.limits import FULL_POLICIES, Limits
from ...server.serving import Running, Serving
from .. import logs
from ..arguments import typed_options
from ..output import complain, inform
from ..parser import Parser, declare
from ..tracing import print_frame
from .over_http import exposed, shown

if TYPE_CHECKING:
    from ...server.server import Server
    from ...tools.page.table_source import ShownTable

logger: HarmlessLogger = HarmlessLogger(__name__)

NOTHING = "there are no files, certificates or passwords to read again"


class _ServingCommand:
    """
    A command that serves at URLs.

    `hooks` are arguments of its server; `files` are functions that read a file again on SIGHUP.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        hangup: Hangup,
        trail: Audit | None = None,
        *files: Callable[[], str],
    ) -> None:
        self.hooks: dict[str, Any] = {
            "trace": print_frame if options.verbose else None,
            "audit": trail,
        }
        self.files = [*files]
        self._trail = trail
        self._options = options
        self._hangup = hangup
        limits = typed_options(options, [field.name for field in fields(Limits)])
        if limits.get("idle_timeout") == math.inf:
            limits["idle_timeout"] = None
        if limits:
            self.hooks["limits"] = Limits(**limits)

    def tell(self, lines: Sequence[str]) -> None:
        """Log lines about files that were read again, and record them in the audit trail."""
        line = log_reload(logger, lines or [NOTHING])
        if self._trail is not None:
            self._trail.note_own("reload", line)

    def serve(
        self,
        server: Serving,
        urls: Sequence[str],
        make_shown: Callable[[], Server | ShownTable],
        *,
        begin: Callable[[], object] = lambda: None,
        answer: Callable[[list[str]], object] | None = None,
    ) -> None:
        """
        Serve until a signal; `begin` is called first, and `answer` on SIGHUP with what else was
        read again.
        """
        options = self._options
        answer = answer or self.tell
        page = shown(make_shown, options)
        with exposed(server, options.metrics), page as print_page:

            def listening(running: Running) -> None:
                begin()
                announce(running.urls, is_guarded=bool(options.allow))
                print_page()
                notify_ready()
                self._hangup.release()

            hung_up = self._hangup.answered(answer, *self.files)
            server.serve_forever(*urls, on_listening=listening, on_hangup=hung_up)


@contextlib.contextmanager
def starting(options: argparse.Namespace) -> Iterator[_ServingCommand]:
    """Open the log and the audit trail of a command while the block runs."""
    path = options.audit
    if path is None and options.audit_required:
        raise ValueError("--audit-required needs --audit")
    with logs.logged(options), Hangup() as hangup:
        if path is None:
            yield _ServingCommand(options, hangup)
            return
        try:
            file = AuditFile(path)
        except OSError as error:
            raise ValueError(f"--audit: {path}: {error.strerror}") from None
        trail = Audit(file, required=options.audit_required)

        def reopen() -> str:
            try:
                file.reopen()
            except (OSError, ValueError) as error:
                return Problem(f"nothing is recorded: {error}")
            trail.note_own("audit", "opened again")
            return f"{path}: opened again"

        with contextlib.closing(file):
            yield _ServingCommand(options, hangup, trail, reopen)


def announce(urls: Sequence[str], *, is_guarded: bool) -> None:
    """Print where a server listens, and which endpoints are open to other machines."""
    for url in urls:
        inform(f"listening on {url}")
    ends = {} if is_guarded else {url: parse(url) for url in urls}
    open_urls = [
        url
        for url, end in ends.items()
        if not (end.has_path or end.is_secure or is_loopback(end.host))
    ]
    if open_urls:
        complain(
            f"anyone who can reach {', '.join(open_urls)} can read and write; --allow NETWORK,"
            " or tls:// with certificates, restricts access",
            "warning",
        )


def notify_ready() -> None:
    """Notify the service manager, if there is one, that the command serves: sd_notify(3)."""
    place = os.environ.get("NOTIFY_SOCKET", "")
    if not place.startswith(("/", "@")):
        return
    address = "\0" + place[1:] if place.startswith("@") else place
    # A service manager that has ended is no reason to stop serving.
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"READY=1", address)


class Hangup:
    """SIGHUP, which waits while the ``with`` block starts a command, until `release`."""

    def __enter__(self) -> Self:
        is_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN  # as under nohup
        self._can_close = _has_terminal() and not is_ignored
        self._before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
        return self

    def __exit__(self, *_: Any) -> None:
        if signal.SIGHUP in signal.sigpending():
            signal.sigwait({signal.SIGHUP})  # a command that could not start says why instead
        self.release()

    def release(self) -> None:
        """Allow signals again; those that waited arrive now."""
        signal.pthread_sigmask(signal.SIG_SETMASK, self._before)

    def answered(
        self, answer: Callable[[list[str]], object], *files: Callable[[], str]
    ) -> Callable[[], None]:
        """Return a function for the signal, which reads files again and passes on the lines."""

        def hung_up() -> None:
            if self._can_close and not _has_terminal():
                signal.raise_signal(signal.SIGTERM)
            else:
                answer([*(file() for file in files), *reload_all()])

        return hung_up


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK))
    except OSError:
        return False
    return True


# --- options ----------------------------------------------------------------------------------

OF_LIMITS = """
rare --max-connections N
    maximum number of TCP connections; by default what the open-file limit allows
rare --connections-per-address N
    maximum number of TCP connections per address; by default a tenth of all
rare --frame-timeout S
    seconds from the first byte of a frame to the last
rare --handshake-timeout S
    seconds for a TLS handshake
rare --certificate-interval S
    seconds between checks of the certificates of open TLS connections
rare --idle-timeout S
    seconds without a request after which a connection is closed, or inf
rare --max-unsent BYTES
    bytes of responses buffered for a client that does not read them
rare --requests-per-second N
    requests answered per address; by default all, over UDP 1000
rare --when-full POLICY
    when there is no room for a connection: close-idle closes another one, which is idle; refuse
    closes the new one
--allow NETWORK ...
    serve clients of this network or address only; may be repeated
"""
"""The options are the fields of `Limits`."""

OF_AUDIT = """
--audit FILE
    append a line of JSON to this file for each write, and for each request, connection and TLS
    handshake that is refused; SIGHUP opens it again
--audit-required
    refuse writes with exception 4 while the file cannot be written
"""


def add_limits(command: Parser) -> Any:
    group = command.group("limits on clients")
    declare(
        group,
        OF_LIMITS,
        lambda: {field.name: field.default for field in fields(Limits) if field.name != "allow"},
        max_unsent={"type": int},
        requests_per_second={"type": float},
        when_full={"choices": FULL_POLICIES},
    )
    return group


def add_audit(command: Parser) -> None:
    declare(command.group("audit trail"), OF_AUDIT)
