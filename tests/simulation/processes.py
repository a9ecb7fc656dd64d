"""
Processes within one simulated event loop: what one of them does can be stopped and continued, as
by SIGSTOP and SIGCONT, while time goes on for the others.

Which process a callback belongs to is in its context: tasks inherit it, and so do the timers, the
readers and the callbacks that they ask the loop for.
"""

from __future__ import annotations

import asyncio
import contextvars
import functools
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from .loop import VirtualLoop

Result = TypeVar("Result")

HOST: contextvars.ContextVar[str] = contextvars.ContextVar("HOST", default="10.255.0.1")
"""The address from where a process connects."""

_PROCESS: contextvars.ContextVar[Process | None] = contextvars.ContextVar("_PROCESS", default=None)


class Process:
    """What runs in a context of its own, in a `StoppableLoop`."""

    def __init__(self, host: str) -> None:
        self.host: str = host
        self.is_stopped: bool = False
        self._context = contextvars.copy_context()
        self._context.run(_PROCESS.set, self)
        self._context.run(HOST.set, host)
        self._held: list[Callable[[], object]] = []
        self._held_descriptors: list[Callable[[], object]] = []

    def call(self, function: Callable[..., Result], *args: Any) -> Result:
        """Call a function as a part of this process."""
        return self._context.run(function, *args)

    def begin(self, coroutine: Coroutine[Any, Any, Result]) -> asyncio.Task[Result]:
        """Run a coroutine as a task of this process."""
        return asyncio.create_task(coroutine, context=self._context)

    def stop(self) -> None:
        """Let nothing of it run: what becomes due waits."""
        self.is_stopped = True
        loop = asyncio.get_running_loop()
        assert isinstance(loop, StoppableLoop)
        loop.stopped.append(self)

    def go_on(self, loop: asyncio.AbstractEventLoop | None = None) -> None:
        """Let it run again: first what has arrived for it, then what became due."""
        self.is_stopped = False
        calls, self._held_descriptors = self._held_descriptors, []
        for entry in calls:
            entry()
        (loop or asyncio.get_running_loop()).call_soon(self._release)

    def _release(self) -> None:
        calls, self._held = self._held, []
        for entry in calls:
            entry()

    def hold(self, call: Callable[[], object]) -> None:
        """Call a function when the process continues."""
        self._held.append(call)

    def hold_descriptor(self, call: Callable[[], object]) -> None:
        """Watch a descriptor again when the process continues."""
        self._held_descriptors.append(call)


class _Gate:
    """A callback of a process, which waits while that is stopped."""

    handle: asyncio.Handle

    def __init__(
        self,
        process: Process,
        loop: StoppableLoop,
        callback: Callable[..., object],
        context: contextvars.Context,
    ) -> None:
        self._process = process
        self._loop = loop
        self._callback = callback
        self._context = context

    def __call__(self, *args: Any) -> None:
        if self._process.is_stopped:
            self._process.hold(functools.partial(self._go_on, *args))
        else:
            self._callback(*args)

    def _go_on(self, *args: Any) -> None:
        if not self.handle.cancelled():
            self._loop.call_soon(self._callback, *args, context=self._context)


class StoppableLoop(VirtualLoop):
    """A `VirtualLoop` whose processes can be stopped."""

    def __init__(self, *args: Any) -> None:
        self.stopped: list[Process] = []
        super().__init__(*args)

    def before_cancelling(self) -> None:
        for process in self.stopped:
            process.go_on(self)

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Any = None) -> Any:
        return self._gate(super().call_soon, (), callback, args, context)

    def call_at(
        self, when: float, callback: Callable[..., object], *args: Any, context: Any = None
    ) -> Any:
        return self._gate(super().call_at, (when,), callback, args, context)

    def _gate(
        self,
        call: Callable[..., Any],
        when: tuple[float, ...],
        callback: Callable[..., object],
        args: tuple[Any, ...],
        context: contextvars.Context | None,
    ) -> Any:
        """Ask the loop for a callback, which waits while its process is stopped."""
        process = _PROCESS.get() if context is None else context.get(_PROCESS)
        if process is None:
            return call(*when, callback, *args, context=context)
        context = context or contextvars.copy_context()
        gate = _Gate(process, self, callback, context)
        gate.handle = call(*when, gate, *args, context=context)
        return gate.handle

    def add_reader(self, fd: Any, callback: Callable[..., object], *args: Any) -> None:
        gated = self._gated(self.remove_reader, self.add_reader, fd, callback, args)
        super().add_reader(fd, gated, *args)

    def add_writer(self, fd: Any, callback: Callable[..., object], *args: Any) -> None:
        gated = self._gated(self.remove_writer, self.add_writer, fd, callback, args)
        super().add_writer(fd, gated, *args)

    def _gated(
        self,
        remove: Callable[[Any], object],
        add: Callable[..., object],
        fd: Any,
        callback: Callable[..., object],
        arguments: tuple[Any, ...],
    ) -> Callable[..., object]:
        process = _PROCESS.get()
        if process is None:
            return callback
        context = contextvars.copy_context()

        def gated(*args: Any) -> None:
            if process.is_stopped:
                # A descriptor that stays readable would not let the time pass.
                remove(fd)
                again = functools.partial(context.run, add, fd, callback, *arguments)
                process.hold_descriptor(again)
            else:
                callback(*args)

        return gated
