"""
Loggers whose handlers may fail: a full disk must not end a connection, or a server.

Separate from `checks`, because blocking clients import logging only when there is something to
log.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import traceback
from collections.abc import Iterable
from typing import Any

from .mistakes import Problem


class HarmlessLogger(logging.LoggerAdapter[logging.Logger]):
    """A logger; an exception of one of its handlers goes to stderr, not to the code that logs."""

    def __init__(self, name: str) -> None:
        super().__init__(logging.getLogger(name), None)

    def log(self, level: int, msg: object, *args: object, **options: Any) -> None:
        # The caller of this method's caller is named in records.
        options["stacklevel"] = options.get("stacklevel", 1) + 1
        try:
            self.logger.log(level, msg, *args, **options)
        except Exception:
            with contextlib.suppress(Exception):  # stderr may be closed
                traceback.print_exc(file=sys.stderr)


def log_reload(logger: HarmlessLogger, lines: Iterable[str]) -> str:
    """Log what became of files that were read again, and return the line: INFO, or WARNING."""
    every = [*lines]
    is_problem = any(isinstance(item, Problem) for item in every)
    line = "; ".join(every)
    logger.log(logging.WARNING if is_problem else logging.INFO, "%s", line)
    return line
