"""
The options for an audit trail: who wrote what, and who was refused.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator

from ...server.audit import Audit, AuditFile

__all__ = ["add_arguments", "audited", "recording"]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options to argparse."""
    group = command.add_argument_group("audit trail")
    group.add_argument(
        "--audit",
        metavar="FILE",
        help="append a line of JSON to this file for each write, and for each request, connection"
        " and TLS handshake that is refused; SIGHUP opens it again",
    )
    group.add_argument(
        "--audit-required",
        action="store_true",
        help="refuse writes with exception 4 while the file cannot be written",
    )


@contextlib.contextmanager
def audited(
    options: argparse.Namespace,
) -> Iterator[tuple[Audit | None, list[Callable[[], str]]]]:
    """
    Open the file of the audit trail while the block runs, if there is one.

    Yields:
        The audit trail, and functions to call on SIGHUP, which return what happened.

    Raises:
        ValueError: the file cannot be opened, or none is given and one is required.
    """
    if options.audit is None:
        if options.audit_required:
            raise ValueError("--audit-required needs --audit")
        yield None, []
        return
    try:
        file = AuditFile(options.audit)
    except OSError as error:
        raise ValueError(f"--audit: {options.audit}: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"--audit: {error}") from None

    trail = Audit(file, required=options.audit_required)

    def reopen() -> str:
        try:
            file.reopen()
        except OSError as error:
            return f"{options.audit}: {error.strerror}; the former file is still used"
        trail.note_own("audit", "opened again")
        return f"{options.audit}: opened again"

    with contextlib.closing(file):
        yield trail, [reopen]


def recording(trail: Audit | None, tell: Callable[[str], object]) -> Callable[[str], object]:
    """Return a function that passes on a line about files that were read again, and records it."""
    if trail is None:
        return tell

    def tell_and_record(line: str) -> None:
        tell(line)
        trail.note_own("reload", line)

    return tell_and_record
