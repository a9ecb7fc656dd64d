"""
Signals while a server runs: its own handlers in their turn, and those of the program afterwards.
"""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from types import FrameType
from typing import Any

import pytest

from libmodbus_py.server.forever import signal_handlers

NUMBERS = (signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("fails", [False, True])
def test_the_handlers_of_a_program_are_back_afterwards(fails: bool) -> None:
    def own(number: int, frame: FrameType | None) -> None: ...

    before = {number: signal.signal(number, own) for number in NUMBERS}
    called: list[signal.Signals] = []

    async def main() -> None:
        came = asyncio.Event()

        def note() -> None:
            called.append(signal.SIGHUP)
            came.set()

        with signal_handlers({signal.SIGTERM: came.clear, signal.SIGHUP: note}):
            os.kill(os.getpid(), signal.SIGHUP)
            await came.wait()
            if fails:
                raise ZeroDivisionError

    try:
        if fails:
            with pytest.raises(ZeroDivisionError):
                asyncio.run(main())
        else:
            asyncio.run(main())
        assert called == [signal.SIGHUP]
        assert [signal.getsignal(number) for number in NUMBERS] == [own, own]
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_in_another_thread_signals_are_left_alone() -> None:
    before = [signal.getsignal(number) for number in NUMBERS]
    seen: list[Any] = []

    async def main() -> None:
        with signal_handlers(dict.fromkeys(NUMBERS, lambda: None)):
            seen.extend(signal.getsignal(number) for number in NUMBERS)

    thread = threading.Thread(target=lambda: asyncio.run(main()))
    thread.start()
    thread.join()
    assert seen == before
