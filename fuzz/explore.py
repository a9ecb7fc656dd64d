"""
Every sequence of events that a connection can meet: python -m fuzz.explore [--depth N] ...

A world is a sequence of `--depth` requests to the real state machines of the client
(`Transactions` with `Line` or with `Ids`), without sockets and clocks. Up to `--faults` of the
requests are unusual: the device answers them late, twice, damaged, between noise, never ..., or the
caller asks something else, pauses, cancels, loses the connection or closes the client; on lines,
another master talks, stray bytes come, or a program starts while an answer to another one is under
way. All choices of places and of what is unusual there are tried, with values that stay and values
that change, with and without retries. After the sequence come usual requests.

Looked at after each event:

    wrong       a value of another request
    stale       a value of the same request from before it was asked
    told        a write that was told as refused was carried out, or one that succeeded was not
    order       a request was sent while an earlier one had no outcome yet, and one is a write
    beside      a request was in flight beside a write
    doubt       a request was sent in DOUBT, before a timeout was over
    endless     a wait longer than the timeouts and silences add up to
    spoiled     usual requests still fail after the first few behind the last fault
    repeated    a request fails though its repetition is answered
    lasting     more wrong or stale values than `MOST_WRONG` for each fault; of several faults, if
                such values still come when answers were checked, after ten timeouts

What the rules cannot tell apart is in `EXCEPTIONS`; anything else is an error, and exits with 1.
"""

from __future__ import annotations

import argparse
import heapq
import logging
import math
import os
import sys
import time
from bisect import bisect_right
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import accumulate, combinations, product
from typing import Any, NamedTuple

from libmodbus_py.client.call import NOT_ASKED, Batch, Call, Phase, Timeouts
from libmodbus_py.client.connection import Transactions
from libmodbus_py.client.history import forget_lines
from libmodbus_py.client.line import TIMEOUTS_BETWEEN_CHECKS
from libmodbus_py.client.options import checked_options
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.port import make_port
from libmodbus_py.protocol import pdu
from libmodbus_py.protocol.errors import ExceptionResponse, ModbusConnectionError
from libmodbus_py.protocol.frames import mbap
from libmodbus_py.protocol.framing import Frame, crc16, make_framer, rtu

# Times are in ticks. An answer takes 2. A unit in DOUBT is silent for twice as long.
TIMEOUT = 12.0
SILENCE = 4.0


class Act(NamedTuple):
    """
    What a device does with one request.

    Attributes:
        frames: when each frame comes after the device begins with the request, and which it is.
        busy: how long the device takes; it handles requests in their order.
        does: True if a write is carried out.
    """

    frames: tuple[tuple[float, str], ...]
    busy: float = 2
    does: bool = True


ACTS: dict[str, Act] = {
    "good": Act(((2, "answer"),)),
    "slow": Act(((4, "answer"),), 4),
    "slower": Act(((10, "answer"),), 10),
    "never": Act((), 0, does=False),
    "lost": Act((), 2),
    "damaged": Act(((2, "damaged"),)),
    "late 14": Act(((14, "answer"),), 14),
    "late 17": Act(((17, "answer"),), 17),
    "late 19": Act(((19, "answer"),), 19),
    "late 23": Act(((23, "answer"),), 23),
    "late 29": Act(((29, "answer"),), 29),
    "late 41": Act(((41, "answer"),), 41),
    "twice at once": Act(((2, "answer"), (2, "answer"))),
    "twice +1": Act(((2, "answer"), (3, "answer"))),
    "twice +2": Act(((2, "answer"), (4, "answer"))),
    "twice +5": Act(((2, "answer"), (7, "answer"))),
    "twice +6": Act(((2, "answer"), (8, "answer"))),
    "twice +7": Act(((2, "answer"), (9, "answer"))),
    "twice +9": Act(((2, "answer"), (11, "answer"))),
    "three times": Act(((2, "answer"), (3, "answer"), (4, "answer"))),
    "refused": Act(((2, "refusal"),), does=False),
    "busy": Act(((2, "busy"),), does=False),
    "refused twice": Act(((2, "refusal"), (3, "refusal")), does=False),
    "another unit": Act(((1, "unit"), (2, "answer"))),
    "another function": Act(((1, "function"), (2, "answer"))),
    "noise": Act(((1, "noise"), (2, "answer"))),
    "noise behind": Act(((2, "answer"), (2, "noise"))),
    "noise around": Act(((2, "in noise"),)),
    "echo": Act(((0, "echo"), (2, "answer"))),
    "damaged, then good": Act(((1, "damaged"), (2, "answer"))),
}
ONLY_WITH_IDS = {"swallowed": Act((), 0, does=False)}

# What a caller does: the requests that it makes at once, and what comes before or behind.
MOVES = (
    "A",
    "B",
    "C",
    "F",
    "W",
    "pause A",
    "cancelled",
    "AB",
    "WAW",
    "AW",
    "in order AW",
    "in order AWB",
    "lost",
    "given up",
    "closed",
)
ONLY_ON_LINES = ("others A", "strays A", "started 1 A", "started 3 A")


class Asked(NamedTuple):
    """A request in a world, and the value of its register at that time."""

    letter: str
    call: Call
    asked_at: float
    version: int

    @property
    def has_failed(self) -> bool:
        return isinstance(self.call.outcome, BaseException)


@dataclass
class World:
    """One sequence of events; `wrong` and the others are its errors."""

    has_ids: bool
    changes: bool
    retries: int = 0
    errors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.now = 0.0
        forget_lines()
        self.endpoint = parse("tcp://10.0.0.1:502" if self.has_ids else "rtu+tcp://10.0.0.1:502")
        self.make_client()
        self.timeouts = Timeouts(TIMEOUT, self.retries, self.retries)
        self.framer = make_framer(self.endpoint.framing, "server")
        self.arrivals: list[tuple[float, int, bytes]] = []
        self.count = 0
        self.busy_until = self.faulty_until = 0.0  # when the last frame of an unusual act comes
        self.acts: list[str] = []
        self.version = 1
        self.writes = 0
        self.done_writes: set[int] = set()
        self.asked: list[Asked] = []
        # Unit and function -> when it was last heard of, after it was not answered well.
        self.doubted: dict[tuple[int, int], float] = {}
        self.unjudged: set[Call] = set()  # that were sent
        self.events = 0
        self.wrong_values = 0
        self.silence = SILENCE

    # --- the device ----------------------------------------------------------------------------

    def receive(self, adu: bytes) -> None:
        for frame in self.framer.feed(adu):
            name = self.acts.pop(0) if self.acts else "good"
            act = ACTS.get(name) or ONLY_WITH_IDS[name]
            begins = max(self.now, self.busy_until)
            if name in ("never", "swallowed"):
                begins = self.now
            else:
                self.busy_until = begins + act.busy
            self.handle(frame, act, begins)

    def handle(self, frame: Frame, act: Act, begins: float) -> None:
        request = pdu.decode_request(frame.pdu)
        if isinstance(request, pdu.WriteRegister):
            if act.does:
                self.done_writes.add(request.value)
            answer = request.encode_response(None)
        else:
            assert isinstance(request, pdu.ReadHoldingRegisters | pdu.ReadInputRegisters)
            if self.changes:
                self.version += 1
            code = {(1, 3): request.address, (1, 4): 2, (2, 3): 3}[frame.unit, request.function]
            answer = request.encode_response([0x100 * (code + 10) + self.version % 0x100])
        for after, kind in act.frames:
            self.put(begins + after, self.made(kind, frame, answer))
            if act is not ACTS["good"]:
                self.faulty_until = max(self.faulty_until, begins + after)

    def made(self, kind: str, frame: Frame, answer: bytes) -> bytes:
        unit, request, number = frame
        make = mbap if self.has_ids else rtu
        if kind == "echo":
            return make(number, unit, request)
        if kind == "noise":
            return b"" if self.has_ids else b"\x00"
        if kind == "in noise" and not self.has_ids:
            return b"\x00" + make(number, unit, answer) + b"\x00"
        if kind in ("refusal", "busy"):
            answer = bytes([request[0] | 0x80, 6 if kind == "busy" else 4])
        elif kind == "unit":
            unit = 9
        elif kind == "function":
            answer = b"\x02\x01\x00"
        adu = make(number, unit, answer)
        if kind == "damaged":
            adu = adu[:2] + b"\0\1" + adu[4:] if self.has_ids else adu[:-1] + bytes([adu[-1] ^ 1])
        return adu

    def put(self, at: float, data: bytes) -> None:
        if data:
            self.count += 1
            heapq.heappush(self.arrivals, (at, self.count, data))

    # --- the client ----------------------------------------------------------------------------

    def make_client(self) -> None:
        options = {
            "turnaround": 1.0,
            "timeouts_before_reconnect": 1000,
            "max_in_flight": 4 if self.has_ids else 1,
        }
        settings = checked_options(self.endpoint, options)
        self.connection = Transactions(self.endpoint, settings, make_port(self.endpoint, settings))
        self.connection.life.connecting()
        self.connection.opened(self.now)

    def note_order(self, adu: bytes) -> None:
        """Look whether its unit was silent, and what must come before it has its outcome."""
        at = next(at for at in reversed(range(len(self.asked))) if self.asked[at].call.adu is adu)
        call = self.asked[at].call
        self.unjudged.add(call)
        heard = self.doubted.pop((call.unit, call.function), -math.inf)
        waited = self.now - self.asked[at].asked_at
        if not self.has_ids and self.now + 1e-9 < heard + self.silence and waited < TIMEOUT - 0.1:
            self.errors.add("doubt")
        for earlier in self.asked[max(0, at - 4) : at]:
            other = earlier.call
            is_ordered = (call.changes or other.changes) and (
                self.has_ids or other.unit == call.unit
            )
            if is_ordered and not other.is_done:
                self.errors.add("order")

    def request(self, letter: str) -> tuple[int, pdu.Request[Any]]:
        unit = 1
        made: pdu.Request[Any]
        if letter == "W":
            self.writes += 1
            made = pdu.WriteRegister(9, self.writes)
        elif letter == "F":
            made = pdu.ReadInputRegisters(0, 1)
        else:
            unit = 2 if letter == "C" else 1
            made = pdu.ReadHoldingRegisters("ABC".index(letter) % 2, 1)
        return unit, made

    def ask(self, letter: str) -> Call:
        call = Call(*self.request(letter), self.timeouts)
        self.note_asked(letter, call)
        self.connection.submit(call, self.now)
        return call

    def ask_in_order(self, letters: str) -> list[Call]:
        """Make requests of one caller, which end at the first failure."""
        requests = [self.request(letter)[1] for letter in letters]
        batch = Batch(1, requests, self.timeouts, one_by_one=not self.has_ids)
        for letter, call in zip(letters, batch.calls, strict=True):
            self.note_asked(letter, call)
        self.connection.submit(batch, self.now)
        return batch.calls

    def note_asked(self, letter: str, call: Call) -> None:
        version = self.writes if letter == "W" else self.version
        self.asked.append(Asked(letter, call, self.now, version))

    def send(self) -> None:
        self.connection.start(self.now, self.receive_all)

    def receive_all(self, adus: list[bytes], now: float) -> None:
        for adu in adus:
            self.note_order(adu)
            self.receive(adu)

    def step(self, until: float) -> bool:
        """Go on to the next event; return False if there is none before a time."""
        connection = self.connection
        self.events += 1
        self.send()
        pending = connection.matching.pending.values()
        if len(pending) > 1 and any(call.changes for call in pending):
            self.errors.add("beside")
        arrival = self.arrivals[0][0] if self.arrivals else math.inf
        at = min(arrival, connection.matching.alarm)
        if at > until or at == math.inf:
            self.now = max(self.now, until) if until < math.inf else self.now
            return False
        self.now = max(self.now, at)
        if arrival <= at:
            data = heapq.heappop(self.arrivals)[2]
            self.note_heard(data)
            if connection.take([data], self.now):
                self.send()  # as drivers do, before answers are decoded
        else:
            connection.tick(self.now)
        connection.settle(self.now)
        self.note_failures()
        return True

    def note_failures(self) -> None:
        for entry in self.asked[-3:]:
            outcome = entry.call.outcome
            if entry.call in self.unjudged and isinstance(outcome, BaseException):
                if not isinstance(outcome, ExceptionResponse | ModbusConnectionError):
                    pair = entry.call.unit, entry.call.function
                    self.doubted.setdefault(pair, self.now)
                self.unjudged.discard(entry.call)

    def note_heard(self, data: bytes) -> None:
        if not self.has_ids and len(data) > 1 and not crc16(data):
            pair = data[0], data[1] & 0x7F
            if pair in self.doubted:
                self.doubted[pair] = self.now

    def wait(self, calls: list[Call], until: float = math.inf) -> None:
        begun, most = self.now, (4 + 3 * len(calls)) * (1 + self.retries) * TIMEOUT
        while self.has_open(calls):
            if not self.step(until) and self.has_open(calls):
                self.errors.add("endless")
                return
            if self.now - begun > most:
                self.errors.add("endless")
                return
        for call in calls:
            self.judge(next(request for request in self.asked if request.call is call))

    def has_open(self, calls: list[Call]) -> bool:
        return not all(call.is_done for call in calls)

    def judge(self, asked: Asked) -> None:
        outcome = asked.call.outcome
        failed = isinstance(outcome, BaseException)
        if outcome is NOT_ASKED:  # after a request that failed
            if asked.call.adu and asked.letter == "W":
                self.errors.add("order")
        elif asked.letter == "W":
            if not failed and asked.version not in self.done_writes:
                self.errors.add("told")
            if isinstance(outcome, ExceptionResponse) and asked.version in self.done_writes:
                self.errors.add("told")
        elif not failed:
            code, version = divmod(outcome[0], 0x100)
            error = ""
            if code != 10 + {"A": 0, "B": 1, "F": 2, "C": 3}[asked.letter]:
                error = "wrong"
            elif self.changes and version <= asked.version % 0x100:
                error = "stale"
            if error:
                self.wrong_values += 1
                self.errors.add(error)

    def move(self, move: str, act: str) -> None:
        """Do what a caller does, with a device that does this with the first of its requests."""
        connection = self.connection
        if move.startswith("pause"):
            self.idle(TIMEOUT)
            move = move[6:]
        if move == "cancelled":
            self.acts = [act]
            call = self.ask("A")
            self.idle(1.0)
            if call.state is Phase.SENT:
                self.doubted[1, 3] = self.now
            connection.withdraw(call, self.now)
            return
        if move in ("lost", "given up", "closed"):
            self.acts = [act]
            call = self.ask("A")
            self.idle(1.0)
            was_sent = call.state is Phase.SENT
            error = ModbusConnectionError("gone")
            if move == "closed":
                connection.closed(self.now)
            else:
                connection.lost(error, self.now, by_itself=move == "lost")
            self.arrivals = [] if self.has_ids else self.arrivals
            if was_sent:
                self.doubted[1, 3] = self.now
            if move == "closed":
                self.make_client()
            else:
                connection.life.connecting()
                connection.opened(self.now)
            self.wait([call])
            return
        if move.startswith("others"):  # another master polls unit 9
            for at in range(3, 60, 3):
                self.put(self.now + at, rtu(0, 9, b"\x03\0\0\0\x01"))
                self.put(self.now + at + 0.5, rtu(0, 9, b"\x03\x02\0\0"))
            move = move[7:]
        elif move.startswith("strays"):  # which may be the beginning of an answer
            for at in range(1, 60, 2):
                self.put(self.now + at + 0.5, b"\x01")
            move = move[7:]
        elif move.startswith("started"):  # while another program gets an answer from B
            forget_lines()
            self.make_client()
            self.silence = 0.0  # nothing is known of the times of the unit
            after = int(move.split()[1])
            frame = Frame(1, self.request("B")[1].encode())
            self.handle(frame, Act(((after, "answer"),)), self.now)
            self.busy_until = self.now + after
            move = "A"
        self.acts = [act]
        if move.startswith("in order"):
            self.wait(self.ask_in_order(move[9:]))
        else:
            self.wait([self.ask(letter) for letter in move])

    def idle(self, ticks: float) -> None:
        until = self.now + ticks
        while self.step(until):
            pass
        self.now = until


Steps = list[tuple[str, str]]

# Acts and moves that leave an answer behind which nobody awaits; and those without one in time, or
# with one that may come after HOLD, which is twice as long as a good one takes.
_SURPLUS = ("late", "twice", "three", "refused twice", "cancelled", "lost", "given up")
_MISSING = (
    *("late", "slow", "never", "lost", "swallowed", "damaged", "cancelled", "given up"),
    *("others", "strays"),  # among whose bytes an answer may be missed
)

# The most values of other requests that follow one fault of a device, and each of several.
MOST_WRONG, MOST_WRONG_EACH = 3, 6

EXCEPTIONS: dict[str, str] = {
    "doubled answer": "An answer comes twice, and the second time while another request, or the "
    "same one again, is in flight. It is taken for the answer to that if it comes as long behind "
    "the request as usual answers, and is equal to no earlier one, or if none was doubled on this "
    "line before. At most three values.",
    "answer to another program": "A program starts while an answer to another one is under way, "
    "and the next answer comes later than HOLD lasts. At most three values.",
    "before the first answer": "A unit that has never answered, and then answers after a timeout "
    "of silence: this is taken for the answer to the request in flight. At most three values.",
    "unknown times": "A unit whose first answer was late, or one whose late answer comes among "
    "bytes of others: its silence after that is too short. No value.",
    "alone in HOLD": "A late or doubled answer, and then a request that is not answered in time "
    "itself, or takes twice as long as any before: the first one is alone while it is held, and is "
    "believed. It concerns one value, or the outcome of one write, for each such pair; if no time "
    "is unusual, as many as come in ten timeouts.",
}


def exception_for(world: World, steps: Steps, unusual: Steps) -> str | None:
    """Return the name of the exception that explains the errors of a world; None for none."""
    errors = world.errors
    names = [name for move, act in unusual for name in (move, act)]
    # The answer to a write is its own echo.
    names += ["twice" for move, act in unusual if act == "echo" and "W" in move]
    surplus = [name for name in names if name.startswith(_SURPLUS)]
    missing = [name for name in names if name.startswith(_MISSING)]
    if world.has_ids or not errors <= {"wrong", "stale", "told", "doubt"}:
        return None
    is_started = any(move.startswith("started") for move, _ in unusual)
    is_usual = [step == ("AB"[at % 2], "good") for at, step in enumerate(steps)]
    is_among_others = any(move.startswith(("others", "strays")) for move, _ in unusual)
    if "doubt" in errors and is_usual[0] and not (is_started or is_among_others):
        return None
    if errors == {"doubt"}:
        return "unknown times"
    if is_started:
        return "answer to another program"
    if not surplus:
        return None
    if len({*surplus, *missing}) > 1 or len(surplus) > 1:
        return "alone in HOLD"
    is_first = not is_usual[0] or any(
        move in ("C", "F") and act in surplus for move, act in unusual
    )
    if surplus[0].startswith("late") and is_first:
        return "before the first answer"
    is_copy = surplus[0].startswith(("twice", "three", "refused twice"))
    return "doubled answer" if is_copy and "told" not in errors else None


def run(has_ids: bool, changes: bool, retries: int, steps: Steps) -> World:
    """Return the world of a sequence of moves and acts, and usual ones behind it."""
    world = World(has_ids, changes, retries)
    for move, act in steps:
        world.move(move, act)
    unusual = [act for move, act in steps if act != "good" or move not in ("A", "B")]
    is_lost_once = len(unusual) == 1 and unusual[0] in ("never", "lost", "damaged")
    is_lost_once &= not any(move == "closed" for move, _ in steps)
    if retries and is_lost_once and any(request.has_failed for request in world.asked):
        world.errors.add("repeated")
    while world.now <= world.faulty_until:
        world.move("A", "good")
    for number in range(12):
        world.move("AB"[number % 2], "good")
    found = set(world.errors)
    world.errors.clear()
    first = len(world.asked)
    for number in range(4):
        world.move("AB"[number % 2], "good")
    if any(request.has_failed for request in world.asked[first:]):
        found.add("spoiled")
    most = MOST_WRONG if len(unusual) == 1 else MOST_WRONG_EACH * len(unusual)
    is_lasting = world.errors or world.wrong_values > most
    if is_lasting and len(unusual) > 1:  # as long as no answer takes an unusual time
        found |= world.errors
        checked_at = world.now + TIMEOUTS_BETWEEN_CHECKS * TIMEOUT
        while world.now < checked_at:
            world.move("A", "good")
            world.move("B", "good")
        world.errors.clear()
        for number in range(4):
            world.move("AB"[number % 2], "good")
        is_lasting = world.errors
    if is_lasting:
        found.add("lasting")
    world.errors = found
    return world


# A prime, so that a sample of all worlds comes first.
STRIDE = 1_000_003


class Found(NamedTuple):
    """The number of worlds and events so far, and the errors with an example each."""

    worlds: int
    events: int
    exceptions: Counter[str]
    errors: dict[str, tuple[int, str]]


class Worlds:
    """
    All worlds of a depth with up to so many unusual requests, by their number.

    Args:
        acts, moves: what is unusual.
    """

    def __init__(self, depth: int, faults: int, acts: list[str], moves: tuple[str, ...]) -> None:
        self._usual: Steps = [("AB"[at % 2], "good") for at in range(depth)]
        self._unusual: Steps = [
            (move, act) for move in ("", *moves) for act in acts if move or act != "good"
        ]
        self._places = [
            places for count in range(faults + 1) for places in combinations(range(depth), count)
        ]
        self._ends = list(accumulate(len(self._unusual) ** len(place) for place in self._places))
        self.count: int = self._ends[-1]

    def __getitem__(self, number: int) -> tuple[Steps, Steps]:
        """Return the steps of a world, and those of them that are unusual."""
        at = bisect_right(self._ends, number)
        steps, chosen = list(self._usual), []
        left = number - (self._ends[at - 1] if at else 0)
        for place in self._places[at]:
            left, which = divmod(left, len(self._unusual))
            move, act = self._unusual[which]
            steps[place] = move or steps[place][0], act
            chosen.append((move, act))
        return steps, chosen


def explore(
    has_ids: bool,
    depth: int,
    faults: int,
    part: tuple[int, int] = (0, 1),
    stop: float = math.inf,
    moves: tuple[str, ...] = MOVES,
) -> Found:
    """
    Walk through all worlds, or every n-th of them, in an order in which any first part is a sample.

    Args:
        part: the number of this part, and how many there are.
        stop: when to stop (time.monotonic).
    """
    logging.disable(logging.WARNING)
    acts = [*ACTS, *(ONLY_WITH_IDS if has_ids else ())]
    every = Worlds(depth, faults, acts, moves if has_ids else (*moves, *ONLY_ON_LINES))
    count = events = 0
    exceptions: Counter[str] = Counter()
    errors: dict[str, tuple[int, str]] = {}
    for number in range(part[0], every.count, part[1]):
        if time.monotonic() > stop:
            break
        steps, unusual = every[number * STRIDE % every.count]
        for changes, retries in product((False, True), (0, 1)):
            world = run(has_ids, changes, retries, steps)
            count += 1
            events += world.events
            if not world.errors:
                continue
            name = exception_for(world, steps, unusual)
            if name is not None:
                exceptions[name] += 1
                continue
            shown = " ".join(f"{move}:{act}" for move, act in steps)
            for error in world.errors:
                before, _ = errors.get(error, (0, ""))
                errors[error] = before + 1, f"{shown} (changes={changes}, retries={retries})"
    return Found(count, events, exceptions, errors)


def main(arguments: list[str] | None = None) -> int:
    """Explore, and print what was found; return 1 if there are errors."""
    parser = argparse.ArgumentParser(prog="explore", description=__doc__.split("\n")[1])
    parser.add_argument("--depth", type=int, default=8, help="requests of a world")
    parser.add_argument("--faults", type=int, default=2, help="the most unusual ones among them")
    parser.add_argument("--seconds", type=float, default=math.inf, help="when to stop")
    options = parser.parse_args(arguments)
    parts = os.cpu_count() or 1
    status = 0
    for has_ids in (False, True):
        begun = time.monotonic()
        stop = begun + options.seconds / 2
        with ProcessPoolExecutor(parts) as pool:
            futures = [
                pool.submit(explore, has_ids, options.depth, options.faults, (at, parts), stop)
                for at in range(parts)
            ]
            results = [future.result() for future in futures]
        count, events = sum(item.worlds for item in results), sum(item.events for item in results)
        taken = sum((result.exceptions for result in results), Counter[str]())
        print(
            f"{'with' if has_ids else 'without'} ids: {count} worlds of {options.depth} requests, "
            f"{events} events, {time.monotonic() - begun:.0f} s"
        )
        for name, number in taken.items():
            print(f"  {number} of the exception {name!r}")
        for result in results:
            for error, (number, example) in result.errors.items():
                print(f"  ERROR {error}: {number}, such as {example}")
                status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
