"""
A task that waits for its requests.

With a Future, it would go on one turn of the event loop after the answer was read, and that turn
takes a tenth of the instructions of a read. Here it goes on at once.
"""

from __future__ import annotations

from asyncio import AbstractEventLoop, CancelledError, current_task, get_running_loop
from collections.abc import Callable, Generator
from contextvars import Context
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .call import Batch, Call

__all__ = ["TaskCaller"]


class TaskCaller:
    """
    The part of a Future that a task needs which submits a job, and awaits this until it is over.

    `withdraw` is called with the job if the task goes away before the job is over.
    """

    __slots__ = (
        *("_asyncio_future_blocking", "_cancelled", "_context", "_job", "_loop", "_resume"),
        "_withdraw",
    )

    def __init__(
        self, loop: AbstractEventLoop, job: Call | Batch, withdraw: Callable[[Call | Batch], None]
    ) -> None:
        self._loop = loop
        self._job = job
        self._withdraw = withdraw
        self._resume: Callable[[Any], object] | None = None  # resumes the waiting task
        self._cancelled: CancelledError | None = None

    def go_on(self) -> None:
        """Resume the task, if it waits: at once, unless another task calls this."""
        resume, self._resume = self._resume, None
        if resume is None:
            return
        if current_task(self._loop) is None:
            self._context.run(resume, self)
        else:
            self._loop.call_soon(resume, self, context=self._context)

    def __await__(self) -> Generator[TaskCaller, None, Any]:
        job = self._job
        try:
            if not job.is_done:
                self._asyncio_future_blocking = True  # tells a task that this is like a Future
                yield self
        finally:
            if not job.is_done:
                self._withdraw(job)
        return job.result()

    # --- called by the task -------------------------------------------------------------------

    # In C; a task runs in its own loop.
    get_loop: Callable[[], AbstractEventLoop] = staticmethod(get_running_loop)

    def add_done_callback(self, resume: Callable[[Any], object], *, context: Context) -> None:
        self._resume, self._context = resume, context

    def cancel(self, msg: Any = None) -> bool:
        resume, self._resume = self._resume, None
        if resume is None:
            return False  # it was resumed already, and the cancellation follows
        self._cancelled = CancelledError() if msg is None else CancelledError(msg)
        self._loop.call_soon(resume, self, context=self._context)
        return True

    def result(self) -> None:
        if self._cancelled is not None:
            raise self._cancelled
