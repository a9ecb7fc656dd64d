"""Tests that are coroutines: each is given first what was made for it, and then its fixtures."""

import functools
import inspect
from collections.abc import Callable, Coroutine
from typing import Any

from .network import Network

Test = Callable[..., Coroutine[Any, Any, None]]


def runner_of(run: Callable[[Test], None], count: int = 1) -> Callable[[Test], Callable[..., None]]:
    """
    Return a decorator of tests. `run`: calls what it is given with what it has made, and runs the
    coroutine to its end; `count`: of the arguments with which `run` calls it; all further ones are
    fixtures.
    """

    def decorate(test: Test) -> Callable[..., None]:
        @functools.wraps(test)
        def whole(**fixtures: Any) -> None:
            run(functools.partial(test, **fixtures))

        fixtures = list(inspect.signature(test).parameters.values())[count:]
        whole.__signature__ = inspect.Signature(fixtures)  # type: ignore[attr-defined]
        return whole

    return decorate


simulated = runner_of(lambda test: Network().run(test), count=0)
"""Run a test in simulated time; it is given nothing but its fixtures."""
