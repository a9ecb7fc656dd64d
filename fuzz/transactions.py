"""
Transactions whose outcome is known, over a line on which things go wrong.

Every cell of the device has a value that depends on its address alone, so a read has
one right result. A write puts these values where something else was put before, over
another connection that is in order, and is looked at over the same. Nothing but the
right result or an error may come of it.
"""

from __future__ import annotations

import contextlib
import os
import pty
import random
import threading
import time
import tty
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, Self

from fuzz.bad_line import FAULTS, BadLine
from libmodbus_py import Client, Device, Mapping, ModbusError

__all__ = [
    "FIXED",
    "Lateness",
    "Tally",
    "Transactions",
    "known_device",
    "register",
    "seconds_left",
]

FIXED = range(1000)  # cells that no client writes
WRITTEN = range(1000, 2000)

# One frame in so many has a fault, unless the line is still recovering from the last.
BETWEEN_FAULTS = 6

# The functions that are used.
FUNCTIONS = (1, 2, 3, 4, 5, 6, 15, 16, 23)


def register(address: int) -> int:
    """Return the value of a register, 1..65535."""
    return (address * 40503 + 12345) % 65535 + 1


def bit(address: int) -> bool:
    return bool(register(address) & 0x40)


def known_device() -> Device:
    """Make a device with these values, and zeros in the writable cells."""
    mapping = Mapping(
        coils=2000,
        discrete_inputs=len(FIXED),
        holding_registers=2000,
        input_registers=len(FIXED),
    )
    mapping.coils[: len(FIXED)] = mapping.discrete_inputs[:] = [bit(at) for at in FIXED]
    mapping.coils[len(FIXED) :] = [not bit(at) for at in WRITTEN]
    registers = [register(at) for at in FIXED]
    mapping.holding_registers[: len(FIXED)] = mapping.input_registers[:] = registers
    return Device(mapping)


@dataclass
class Tally:
    """
    What happened.

    Attributes:
        done: transactions, whatever their outcome.
        injected: faults by kind and side; a transaction has one at most.
        errors: transactions that were reported as failed, by class of the error.
        wrong: results that were not those of the device, and registers that hold
            what nobody wrote.
        unprovoked: failed transactions of a function that was not in doubt, unless the fault of the
            one before had spoiled nothing yet (noise behind a request hides the next one).
        lost: writes that were reported as done and were not.
        recovery: failed transactions of a function on the clean line after it was in doubt, and
            since the last fault of any function: how often so many. One is usual: an answer in
            doubt is held, and may be held for too long.
        unjudged: transactions during or right after which the machine was too busy, so that
            an answer may have been later than a serial client can reckon with.
        outdated: answers that the line lost because they were too late to be fair.
        examples: the first findings, in words.
    """

    done: int = 0
    injected: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    wrong: int = 0
    unprovoked: int = 0
    lost: int = 0
    recovery: Counter[int] = field(default_factory=Counter)
    unjudged: int = 0
    outdated: int = 0
    examples: list[str] = field(default_factory=list)

    @property
    def is_good(self) -> bool:
        """Return True if no value was wrong or lost, and each fault caused one failure."""
        findings = self.wrong + self.lost + self.unprovoked
        return not findings and max(self.recovery, default=0) <= 1

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            *(getattr(self, field.name) + getattr(other, field.name) for field in fields(self))
        )

    def note(self, text: str) -> None:
        if len(self.examples) < 20:
            self.examples.append(text)

    def __str__(self) -> str:
        rows = {
            "transactions": self.done,
            "faults": self.injected.total(),
            **{f"  {kind}": count for kind, count in sorted(self.injected.items())},
            "errors": self.errors.total(),
            **{f"  {kind}": count for kind, count in sorted(self.errors.items())},
            "wrong values": self.wrong,
            "losses not reported": self.lost,
            "failures without a fault": self.unprovoked,
            "failures on the clean line after a fault": "",
            **{f"  {number}": count for number, count in sorted(self.recovery.items())},
            "not judged, machine too busy": self.unjudged,
            "answers too late to be fair": self.outdated,
        }
        return "\n".join(
            [*(f"{name:42}{count:>9}" for name, count in rows.items()), *self.examples]
        )


class Lateness:
    """
    How late things are on this machine through no fault of ours.

    Threads wait for a processor, and bytes inside a pseudo-terminal for the kernel's workers:
    on a busy machine for longer than any timeout that a test can wait for.
    """

    PERIOD = 0.01

    def __init__(self) -> None:
        self._ends = pty.openpty()
        tty.setraw(self._ends[1])
        self._queued = self._queueing()
        self._worst = 0.0
        self._last = time.monotonic()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="lateness", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        for end in self._ends:
            os.close(end)

    def seconds(self) -> float:
        """Return the sum of both, at worst, since the last call."""
        overdue = time.monotonic() - self._last - self.PERIOD  # of the next beat
        worst, self._worst = max(self._worst, overdue), 0.0
        queued, self._queued = self._queued, self._queueing()
        return worst + max(0.0, self._queued - queued)

    def _beat(self) -> None:
        while not self._stopped.wait(self.PERIOD):
            os.write(self._ends[0], b".")
            os.read(self._ends[1], 1)
            now = time.monotonic()
            self._worst = max(self._worst, now - self._last - self.PERIOD)
            self._last = now

    @staticmethod
    def _queueing() -> float:
        """Return the seconds that all threads waited for a processor; 0 if not counted."""
        nanoseconds = 0
        for thread in Path("/proc/self/task").iterdir():
            with contextlib.suppress(OSError):  # it may have ended
                nanoseconds += int((thread / "schedstat").read_text().split()[1])
        return nanoseconds / 1e9


class Finding(Exception):
    """An outcome that must never occur."""

    def __init__(self, kind: Literal["wrong", "lost"], text: str) -> None:
        super().__init__(text)
        self.kind = kind


class Transactions:
    """
    Args:
        context: the client on the bad line.
        clean: a client of the same device on a line in order.
        line: the bad line.
        lateness: of this machine.
        seed: of the random choices.

    Attributes:
        tally: what happened so far.
    """

    def __init__(
        self, context: Client, clean: Client, line: BadLine, lateness: Lateness, seed: int
    ) -> None:
        self.tally = Tally()
        self._context = context
        self._clean = clean
        self._line = line
        self._lateness = lateness
        self._late_before = False
        self._random = random.Random(seed)
        self._kind, self._count = KINDS[0], 1
        self._repeats = False
        self._is_owed = False  # the last transaction ended well in spite of a fault
        # Functions in doubt -> failures on the clean line since then.
        self._failures: dict[int, int] = {}

    def run(self, goes_on: Callable[[], bool]) -> Tally:
        """Do transactions while `goes_on` returns True."""
        while goes_on():
            self._one()
            if self.tally.done % 200 == 0:
                self._look_at_all()
        self._look_at_all()
        self.tally.injected = Counter()
        for (kind, sender), count in self._line.injected.items():
            self.tally.injected[f"{kind}, {sender}"] = count
        self.tally.outdated = self._line.outdated
        return self.tally

    def _one(self) -> None:
        was_clean = self._line.is_clean
        if was_clean and not self._repeats and self._random.random() * BETWEEN_FAULTS < 1:
            self._line.arm(
                self._random.choice([*FAULTS]), self._random.choice(["client", "server"])
            )
            was_clean = False
        if not self._repeats:
            self._kind = self._random.choice(KINDS)
        trouble: ModbusError | Finding | None = None
        function = None
        try:
            function = self._kind(self)
        except ModbusError as error:
            trouble, function = error, error.function
            self.tally.errors[type(error).__name__] += 1
        except Finding as finding:
            trouble = finding
        self._line.disarm()
        # As long as an answer may be late, the next request is the one that it fits best.
        self._repeats = trouble is not None or not self._line.is_clean
        self.tally.done += 1
        if self._was_late((was_clean and trouble is not None) or isinstance(trouble, Finding)):
            self.tally.unjudged += 1
            self._failures = dict.fromkeys(FUNCTIONS, 0)
        elif isinstance(trouble, Finding):
            setattr(self.tally, trouble.kind, getattr(self.tally, trouble.kind) + 1)
            self._note_line(str(trouble))
        else:
            assert function is not None
            self._judge_recovery(was_clean, function, trouble)

    def _was_late(self, is_suspicious: bool) -> bool:
        """Return True if the machine delayed this request, or the last one, answered now."""
        if is_suspicious:
            time.sleep(self._context.timeout)  # late frames are received
        is_late = self._lateness.seconds() > self._context.timeout / 4
        was_late, self._late_before = self._late_before, is_late
        return is_late or was_late

    def _judge_recovery(self, was_clean: bool, function: int, error: ModbusError | None) -> None:
        if not was_clean:  # a late frame of a unit prolongs the doubt of all its functions
            self._failures = dict.fromkeys(self._failures, 0)
        if error is None:
            if function in self._failures:
                self.tally.recovery[self._failures.pop(function)] += 1
        elif not was_clean or self._is_owed:
            self._failures[function] = 0
        elif function not in self._failures:
            self._failures[function] = 1
            self.tally.unprovoked += 1
            self._note_line(f"failed on a line in order: {error}")
        else:
            self._failures[function] += 1
            if self._failures[function] > 1:
                self._note_line(f"failed again on the clean line: {error}")
        self._is_owed = error is None and not was_clean

    def _note_line(self, text: str) -> None:
        self.tally.note("\n    ".join([text, *map(str, self._line.recent)]))

    def _span(self, cells: range, most: int) -> tuple[int, int]:
        if not self._repeats:
            self._count = self._random.choice([1, 2, self._random.randint(1, most), most])
        count = min(self._count, most)
        return self._random.randrange(cells.start, cells.stop - count + 1), count

    def _expect(self, what: str, got: object, expected: object) -> None:
        if got != expected:
            raise Finding("wrong", f"{what}: {got} instead of {expected}")

    def _read_registers(self) -> int:
        address, count = self._span(FIXED, 125)
        name = self._random.choice(["read_holding_registers", "read_input_registers"])
        got = getattr(self._context, name)(address, count)
        expected = [register(at) for at in range(address, address + count)]
        self._expect(f"{name}({address}, {count})", got, expected)
        return 3 if name == "read_holding_registers" else 4

    def _read_bits(self) -> int:
        address, count = self._span(FIXED, 1000)
        name = self._random.choice(["read_coils", "read_discrete_inputs"])
        got = getattr(self._context, name)(address, count)
        expected = [bit(at) for at in range(address, address + count)]
        self._expect(f"{name}({address}, {count})", got, expected)
        return 1 if name == "read_coils" else 2

    def _write_registers(self) -> int:
        address, count = self._span(WRITTEN, 121)
        values = [register(at) for at in range(address, address + count)]
        self._clean.write_registers(address, [0] * count)
        function = 16
        if count == 1:
            function = 6
            self._context.write_register(address, values[0])
        elif self._random.random() < 0.5:
            self._context.write_registers(address, values)
        else:
            function = 23
            at, size = self._span(FIXED, 125)
            got = self._context.read_write_registers(at, size, address, values)
            expected = [register(number) for number in range(at, at + size)]
            self._expect(f"read_write_registers({at}, {size})", got, expected)
        self._expect_written(address, self._clean.read_holding_registers(address, count), values)
        return function

    def _write_bits(self) -> int:
        address, count = self._span(WRITTEN, 900)
        values = [bit(at) for at in range(address, address + count)]
        self._clean.write_coils(address, [not value for value in values])
        if count == 1:
            self._context.write_coil(address, values[0])
        else:
            self._context.write_coils(address, values)
        self._expect_written(address, self._clean.read_coils(address, count), values)
        return 5 if count == 1 else 15

    def _expect_written(self, address: int, found: object, values: object) -> None:
        if found != values:
            raise Finding("lost", f"wrote {values} at {address}, found {found}")

    def _look_at_all(self) -> None:
        """Check all registers: each must have a value that was written."""
        for start in range(0, WRITTEN.stop, 100):
            for at, value in enumerate(self._clean.read_holding_registers(start, 100), start):
                allowed = (register(at), 0) if at in WRITTEN else (register(at),)
                if value not in allowed:
                    self.tally.wrong += 1
                    self.tally.note(f"register {at} holds {value}, not {allowed}")


KINDS = [
    Transactions._read_registers,
    Transactions._read_bits,
    Transactions._write_registers,
    Transactions._write_bits,
]


def seconds_left(seconds: float) -> Callable[[], bool]:
    """Return a function that returns True for so many seconds."""
    end = time.monotonic() + seconds
    return lambda: time.monotonic() < end
