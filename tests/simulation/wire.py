"""
What is sent in a simulated world, read for the witness: requests to units, what a gateway refuses,
and whose turn it was.
"""

from __future__ import annotations

from collections import Counter

from .events import Events
from .rules import Key, Witness

__all__ = ["Wire"]

# How long a request may be on its way to a gateway.
ARRIVING = 0.001


class Wire:
    """Reads what is sent, and tells the witness: requests to units, and refusals by gateways."""

    def __init__(self, events: Events, witness: Witness) -> None:
        self.hosts_take_turns: bool = False
        self._witness = witness
        self._events = events
        self._asked: dict[tuple[int, bytes], tuple[int, bytes]] = {}
        # Of each host that waits for a line: its requests, and how many of each other host went
        # out before the first of them.
        self._waiting: dict[str, dict[Key, float]] = {}
        self._overtaken: dict[str, Counter[str]] = {}
        self.host: dict[Key, str] = {}

    def tell(self, place: str, connection: int, is_client: bool, data: bytes) -> None:
        """See `Network.tap`."""
        has_header = place.startswith("tcp:")
        for head, unit, pdu in _frames(data, has_header, is_client):
            if place.startswith("tcp://10.0.1."):  # a gateway's own clients
                self._note_at_gateway(connection, head, unit, pdu, is_client)
            elif is_client:
                self._witness.sent(unit, pdu)
                if self.hosts_take_turns:
                    self._note_turn((unit, pdu))

    def _note_at_gateway(
        self, connection: int, head: bytes, unit: int, pdu: bytes, is_client: bool
    ) -> None:
        if is_client:
            self._asked[connection, head] = unit, pdu
            if self.hosts_take_turns:
                self._note_waiting((unit, pdu))
            return
        key = self._asked.pop((connection, head), None)
        if key is not None and pdu[0] & 0x80 and pdu[1] in (6, 11):
            self._witness.refused(*key)

    # --- turns ------------------------------------------------------------------------------------

    def _note_waiting(self, key: Key) -> None:
        host = self.host[key]
        self._waiting.setdefault(host, {})[key] = self._events.now
        self._overtaken.setdefault(host, Counter())

    def _note_turn(self, key: Key) -> None:
        """
        A request of a host went out: no other one that waits may be overtaken by two of it.

        One more may have been taken already, and wait for the silence of the line.
        """
        host = self.host[key]
        self._waiting.get(host, {}).pop(key, None)
        self._overtaken[host] = Counter()
        arrived = self._events.now - ARRIVING
        for other, waiting in self._waiting.items():
            # What was sent to the gateway just now may not have arrived there.
            if other == host or not any(at < arrived for at in waiting.values()):
                continue
            self._overtaken[other][host] += 1
            if self._overtaken[other][host] > 2:
                self._witness.fail("hosts take turns", f"{host} was served thrice before {other}")


def _frames(data: bytes, has_header: bool, is_client: bool) -> list[tuple[bytes, int, bytes]]:
    """Cut what was sent together; only requests of a line are looked at."""
    if not has_header:
        size = 8 if is_client else len(data)
        return [(b"", data[at], data[at + 1 : at + size - 2]) for at in range(0, len(data), size)]
    found = []
    while len(data) >= 8:
        size = 6 + int.from_bytes(data[4:6], "big")
        found.append((data[:2], data[6], data[7:size]))
        data = data[size:]
    return found
