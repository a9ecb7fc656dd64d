"""
The requests and responses of a server, as transactions.
"""

from __future__ import annotations

import math
from collections import deque

from ...ports.trace import Traced
from ..listener.traces import TracePairing
from ..listener.transaction import Transaction

__all__ = ["MOST", "Exchanges"]

# The most ADUs of one server that are kept: more than a test needs, and a limit for long runs.
MOST = 20_000


class Exchanges:
    """
    The last `MOST` ADUs of one server. Safe from any thread.

    They are paired only when `transactions` is called, so that this does not slow down the server.
    """

    def __init__(self) -> None:
        self._traced: deque[Traced] = deque(maxlen=MOST)

    def note(self, traced: Traced) -> None:
        """Take an ADU of the trace of the server."""
        self._traced.append(traced)

    def transactions(self) -> list[Transaction]:
        """Return all transactions, in the order in which they began."""
        pairing = TracePairing(timeout=math.inf)
        for traced in self._traced.copy():
            pairing.take(traced)
        pairing.end()
        return sorted((each.transaction for each in pairing.done), key=lambda each: each.time)
