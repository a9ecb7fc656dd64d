"""
The log of commands that run for long: --log and --log-format.

Without them, Python prints the messages of warnings and errors alone.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import sys
from collections.abc import Callable, Iterator
from typing import Any

from ..protocol.plain import time_text
from .output import log_line
from .parser import Parser, declare

PACKAGE = "libmodbus_py"

LEVELS = ("debug", "info", "warning", "error")

OPTIONS = f"""
--log LEVEL
    lowest level to log: {", ".join(LEVELS)}; debug logs every frame. Each line begins with the time
rare --log-format FORMAT
    json, one object in each line; or text
"""


def add_arguments(command: Parser) -> None:
    group = command.group("log, on stderr")
    declare(group, OPTIONS, log={"choices": LEVELS}, log_format={"choices": ("json", "text")})


@contextlib.contextmanager
def logged(options: argparse.Namespace) -> Iterator[None]:
    """Log as the options say while the block runs."""
    if options.log is None and options.log_format is None:
        yield
        return
    logger, root = logging.getLogger(PACKAGE), logging.getLogger()
    handler = _Handler(sys.stderr)
    handler.setFormatter(LogFormatter(is_json=options.log_format == "json"))
    handler.setLevel((options.log or "warning").upper())
    before = logger.level
    root.addHandler(handler)  # for warnings of asyncio and other packages, too
    logger.setLevel(handler.level)
    logging.captureWarnings(True)
    try:
        yield
    finally:
        logging.captureWarnings(False)
        root.removeHandler(handler)
        logger.setLevel(before)


@contextlib.contextmanager
def called_before_lines(function: Callable[[], object]) -> Iterator[None]:
    """Call a function before each line of the log while the block runs."""

    def is_printed(record: logging.LogRecord) -> bool:
        function()
        return True

    handlers = [*logging.getLogger().handlers]
    if not handlers and logging.lastResort is not None:
        handlers = [logging.lastResort]
    for handler in handlers:
        handler.addFilter(is_printed)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(is_printed)


class _Handler(logging.StreamHandler[Any]):
    def handleError(self, record: logging.LogRecord) -> None:
        """Drop messages that stderr refuses, such as a closed pipe, without a traceback."""


class LogFormatter(logging.Formatter):
    """Time, level, logger and message, and an exception; as a line of text, or an object."""

    def __init__(self, *, is_json: bool) -> None:
        super().__init__()
        self._is_json = is_json

    def format(self, record: logging.LogRecord) -> str:
        level = record.levelname.lower()
        exception = self.formatException(record.exc_info) if record.exc_info else ""
        if self._is_json:
            return log_line(record.created, level, record.name, record.getMessage(), exception)
        name = record.name.removeprefix(f"{PACKAGE}.")
        text = f"{time_text(record.created)} {level:<7} {name}: {record.getMessage()}"
        return f"{text}\n{exception}" if exception else text
