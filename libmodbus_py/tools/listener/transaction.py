"""
What a listener gives: a question, its answer, and how it ended.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from ...protocol.errors import ModbusError
from ...protocol.framing import Frame
from ...protocol.pdu import Request

__all__ = ["KINDS", "Heard", "Kind", "OnHeard", "Part", "Transaction"]

Kind = Literal[
    "answered",
    "exception",
    "invalid",
    "late",
    "unanswered",
    "broadcast",
    "damaged",
    "unasked",
]

KINDS: dict[Kind, str] = {
    "answered": "the answer fits the question",
    "exception": "the unit refused",
    "invalid": "an answer came that does not fit the question",
    "late": "the answer came when the client had gone on; the question was given as unanswered",
    "unanswered": "nothing came until the next question, or for long",
    "broadcast": "to unit 0, or a question that asks for silence: nobody answers",
    "damaged": "bytes that are no frame, instead of an answer or without a question",
    "unasked": "an answer that no question is known of, or that it has had",
}

Part = Literal["request", "response", "damage"]


class Heard(NamedTuple):
    """
    A frame that has been named, or bytes that are none.

    Attributes:
        began, ended: when its first and its last byte came, in seconds.
        part: "request", "response" or "damage".
        frame: unit and PDU; None for damage.
        data: the bytes of damage; empty for frames.
    """

    began: float
    ended: float
    part: Part
    frame: Frame | None
    data: bytes = b""


OnHeard = Callable[[Heard], object]


@dataclass(frozen=True, slots=True)
class Transaction:
    """
    What passed between a client and a unit.

    Attributes:
        time: when it began, in seconds since the epoch.
        kind: how it ended, one of `KINDS`.
        unit: 0..255; None where only damaged bytes are known.
        function: the function code, 1..127, or None.
        request: the question, `RawRequest` if it is none that a server would take; None where
            there is none.
        response: what the client's method would have returned; None without an answer.
        error: the refusal (ExceptionResponse), what is wrong with the answer (InvalidResponse),
            or the damaged bytes (FrameError, `received`); None otherwise.
        duration: seconds from the end of the question to the end of the answer, or None.
        repeats: how often the same question had been asked before without an answer.
    """

    time: float
    kind: Kind
    unit: int | None = None
    function: int | None = None
    request: Request[Any] | None = None
    response: Any = None
    error: ModbusError | None = None
    duration: float | None = None
    repeats: int = 0

    @property
    def is_good(self) -> bool:
        """Whether nothing is wrong: answered at once, or a broadcast."""
        return self.kind in ("answered", "broadcast") and not self.repeats

    def __str__(self) -> str:
        where = "" if self.unit is None else f"unit {self.unit}: "
        asked = "" if self.request is None else f"{self.request} "
        again = f" (repeat {self.repeats})" if self.repeats else ""
        return f"{where}{asked}-> {self.outcome()}{again}"

    def outcome(self, show: Callable[[Any], str] = repr) -> str:
        """
        Return in words how it ended.

        Args:
            show: makes the text of a response.
        """
        if self.kind == "unanswered":
            return "no answer"
        if self.error is not None:
            text = str(self.error.args[0])
        elif self.kind in ("answered", "late", "unasked"):
            text = "done" if self.response is None else show(self.response)
        else:
            return self.kind
        return text if self.kind in ("answered", "exception") else f"{self.kind}: {text}"
