"""Frames in columns, as --verbose prints them."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Iterator

from ..ports.trace import WIRE, TracedFrame
from ..protocol.pdu import REQUESTS
from ..protocol.plain import clock_text
from .output import inform


class Tracing:
    """
    A `trace` of one client that prints each frame to stderr: the time, the direction, the unit, the
    function, how long the answer took, and the bytes.
    """

    def __init__(self) -> None:
        self._sent = 0.0

    def __call__(self, frame: TracedFrame) -> None:
        is_sent = frame.direction == "sent"
        self._sent = frame.time if is_sent else self._sent
        inform(_in_columns(frame, None if is_sent else frame.time - self._sent), sys.stderr)


def print_frame(frame: TracedFrame) -> None:
    """Print a frame of a server to stderr, in the same columns."""
    inform(_in_columns(frame), sys.stderr)


@contextlib.contextmanager
def wire_printed(*, is_on: bool) -> Iterator[None]:
    """Print the frames of all clients of this process to stderr while the block runs."""
    if not is_on:
        yield
        return
    logger = logging.getLogger(WIRE)
    handler, before = _WireHandler(), logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)


class _WireHandler(logging.Handler):
    """Prints the frame of each record."""

    def emit(self, record: logging.LogRecord) -> None:
        if isinstance(record.args, tuple) and isinstance(record.args[0], TracedFrame):
            with contextlib.suppress(OSError, ValueError):
                print_frame(record.args[0])


def _in_columns(frame: TracedFrame, took: float | None = None) -> str:
    """Return a frame as one line, with the seconds since its request."""
    clock = clock_text(frame.time, with_milliseconds=True)
    arrow = ">" if frame.direction == "sent" else "<"
    unit = "" if frame.unit is None else frame.unit
    late = "" if took is None else f"{took * 1000:.1f} ms"
    is_text = frame.endpoint.startswith("ascii") and frame.adu.isascii()
    text = repr(frame.adu.decode())[1:-1] if is_text else frame.adu.hex(" ")
    return f"{clock} {arrow} {unit:>3}  {_function(frame):<24} {late:>9}  {text}"


def _function(frame: TracedFrame) -> str:
    if frame.function is None:
        return "no frame"
    request = REQUESTS.get(frame.function & 0x7F)
    if frame.function & 0x80:
        return "refused" if request is None else f"refused {request.__name__}"
    return f"function {frame.function}" if request is None else request.__name__
