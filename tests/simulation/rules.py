"""
What must hold, whatever happens: looked at after every event.

The checker is told what clients ask and what becomes of it, what units carry out, and, by the
network, what is sent. A request is known by its unit, function, address and value, which no other
one has.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

from libmodbus_py import ExceptionResponse, ModbusError

from .devices import COUNT, time_of
from .events import Events

# What the clock of the values may be off.
EXACT = 2e-6

# How long a request may be on its way to a gateway.
ARRIVING = 0.001

Key = tuple[int, bytes]  # a unit and a request PDU


class Broken(AssertionError):
    """A rule does not hold."""

    def __init__(self, rule: str, text: str) -> None:
        super().__init__(f"{rule}: {text}")
        self.rule = rule


@dataclass
class Call:
    """What a client asks."""

    key: Key
    began: float
    until: float
    age: float = 0.0  # seconds that its answer may be old, from a cache
    is_direct: bool = True  # not through a gateway


@dataclass
class Pause:
    """A unit that gives no answer: how long a gateway must leave it alone."""

    timeout: float  # of the line; the first pause, each later one twice as long
    asked: float | None = None
    pause: float = 0.0

    def note(self, now: float) -> float:
        """The unit was asked; return by how many seconds too soon."""
        if self.asked is None:
            self.asked, self.pause = now, self.timeout
            return 0.0
        if not self.pause or now <= self.asked + self.timeout:
            return 0.0  # a request that was in flight with it
        early = self.asked + self.pause - now
        self.asked, self.pause = now, min(2 * self.pause, LONGEST_PAUSE)
        return early


LONGEST_PAUSE = 15.0


@dataclass
class Checker:
    """Sees all, and says at the first thing that may not be."""

    events: Events
    answered: int = 0
    failed: int = 0
    # On a line an answer that comes later than any before, while the next one is late as well,
    # gives one wrong value, and one more if that is later than its HOLD: "alone in HOLD" in
    # docs/protocol/timing.md. They are two of 500 at most.
    is_line: bool = False
    wrong: int = 0
    results: Counter[str] = field(default_factory=Counter)
    paused: dict[int, Pause] = field(default_factory=dict)
    through_gateway: set[Key] = field(default_factory=set)
    _open: dict[Key, Call] = field(default_factory=dict)
    _ended: dict[Key, str] = field(default_factory=dict)
    _executed: dict[Key, list[float]] = field(default_factory=lambda: defaultdict(list))
    _sent: Counter[Key] = field(default_factory=Counter)
    _refused: set[Key] = field(default_factory=set)
    _broken: list[Broken] = field(default_factory=list)

    # --- what clients say -----------------------------------------------------------------------

    def begin(self, call: Call) -> None:
        self._open[call.key] = call

    def answer(self, call: Call, values: list[int] | None) -> None:
        """A call gave values, or, for a write, nothing."""
        self._end(call, "answered")
        self.answered += 1
        times = self._executed.get(call.key, [])
        if values is None:
            if not any(call.began - EXACT <= at for at in times):
                self.fail("an acknowledged write is in the device", f"{_text(call.key)} is not")
            return
        unit, pdu = call.key
        if values[:2] != [unit, int.from_bytes(pdu[1:3], "big")] or len(values) != COUNT:
            self.wrong += 1
            if self.wrong > 2 * self.is_line * (1 + self.answered // 500):
                self.fail("an answer is the one to its request", f"{_text(call.key)} gave {values}")
            return
        if not call.began - call.age - EXACT <= time_of(values) <= self.events.now + EXACT:
            old = call.began - time_of(values)
            self.fail("an answer is the one to its request", f"{_text(call.key)}: {old:.3f} s old")

    def error(self, call: Call, error: BaseException) -> None:
        """A call ended with an error, or was cancelled."""
        self._end(call, type(error).__name__)
        self.failed += 1
        is_unsent = isinstance(error, ModbusError) and not error.sent and call.is_direct
        if is_unsent and not isinstance(error, ExceptionResponse) and self._sent[call.key]:
            self.fail("what was reported as not sent was not", f"{_text(call.key)}: {error!r}")

    def _end(self, call: Call, how: str) -> None:
        self.results[how] += 1
        if self._open.pop(call.key, None) is None:
            self.fail("a call ends once", f"{_text(call.key)}: {self._ended.get(call.key)}, {how}")
        self._ended[call.key] = how
        if self.events.now > call.until + EXACT:
            late = self.events.now - call.until
            self.fail("a call ends by its deadline", f"{_text(call.key)}: {late:.3f} s late")

    # --- what units and the network say -----------------------------------------------------------

    def executed(self, unit: int, pdu: bytes) -> None:
        """A unit carried out a request."""
        key = unit, pdu
        times = self._executed[key]
        times.append(self.events.now)
        if pdu[0] == 6 and len(times) > self._sent[key]:
            self.fail("a write is carried out as often as it was sent", _text(key))

    def compare_order(self, keys: list[Key]) -> None:
        """Requests of one unit were given in this order: none is carried out after the next one."""
        for key, following in pairwise(keys):
            times, later = self._executed.get(key), self._executed.get(following)
            if times and later and times[-1] > later[0]:
                self.fail("requests keep their order around a write", _text(key))

    def sent(self, unit: int, pdu: bytes) -> None:
        """A request left for a unit."""
        key = unit, pdu
        self._sent[key] += 1
        if unit in self.paused and (early := self.paused[unit].note(self.events.now)) > EXACT:
            self.fail("a paused unit gets no request", f"{_text(key)}: {early:.3f} s too soon")
        call = self._open.get(key)
        if key in self._refused or (call is None and self._ended.get(key) and self.is_direct(key)):
            how = self._ended.get(key, "refused")
            self.fail("what failed is never sent later", f"{_text(key)}: {how}")

    def refused(self, unit: int, pdu: bytes) -> None:
        """A gateway refused a request."""
        self._refused.add((unit, pdu))

    def is_direct(self, key: Key) -> bool:
        return key not in self.through_gateway

    # --- all the time -----------------------------------------------------------------------------

    def fail(self, rule: str, text: str) -> None:
        self._broken.append(Broken(rule, f"{text}, at {self.events.now - 1000:.3f} s"))

    def look(self) -> None:
        """Look at everything."""
        if self._broken:
            raise self._broken[0]

    def late(self) -> None:
        """Look for calls that should have ended; dear, so not after each event."""
        for call in self._open.values():
            if self.events.now > call.until + EXACT:
                self.fail("a call ends by its deadline", f"{_text(call.key)} has not ended")

    def forget(self, before: float) -> None:
        """Forget what ended long ago, so that a run of hours takes no more memory."""
        for key in [key for key, times in self._executed.items() if times[-1] < before]:
            del self._executed[key]
            self._sent.pop(key, None)
            self._ended.pop(key, None)
            self._refused.discard(key)
            self.through_gateway.discard(key)


def _text(key: Key) -> str:
    unit, pdu = key
    kind = {3: "read", 6: "write"}.get(pdu[0], str(pdu[0]))
    return f"unit {unit} {kind} {pdu[1:].hex(' ')}"


class Wire:
    """Reads what is sent, and tells the checker: requests to units, and refusals by gateways."""

    def __init__(self, events: Events, checker: Checker) -> None:
        self.hosts_take_turns: bool = False
        self._checker = checker
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
                self._checker.sent(unit, pdu)
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
            self._checker.refused(*key)

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
                self._checker.fail("hosts take turns", f"{host} was served thrice before {other}")


def _frames(data: bytes, has_header: bool, is_client: bool) -> list[tuple[bytes, int, bytes]]:
    """Cut what was sent together; only requests of a line are looked at."""
    if not has_header:
        size = 8 if is_client else len(data)
        return [(b"", data[at], data[at + 1 : at + size - 2]) for at in range(0, len(data), size)]
    frames = []
    while len(data) >= 8:
        size = 6 + int.from_bytes(data[4:6], "big")
        frames.append((data[:2], data[6], data[7:size]))
        data = data[size:]
    return frames
