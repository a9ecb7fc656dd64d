"""
For mkdocstrings: methods of clients give results, though they are written as makers of requests.
"""

from __future__ import annotations

from typing import Any

from griffe import ExprSubscript, Extension, Function

MAKERS = {"asks", "follows"}


class ResultsOfRequests(Extension):
    """Shows what a method of clients gives: X for ``pdu.Request[X]`` and ``Steps[X]``."""

    def on_function(self, *, func: Function, **_: Any) -> None:
        """Look at each function after it was read."""
        made_by = {str(decorator.value) for decorator in func.decorators}
        if made_by & MAKERS and isinstance(func.returns, ExprSubscript):
            func.returns = func.returns.slice
