"""
For mkdocstrings: the results of client methods, and the public names of packages with a stub.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from griffe import ExprSubscript, Extension, Function, Module

MAKERS = {"asks", "follows"}


class ResultsOfRequests(Extension):
    """Show the result of a client method: X for ``pdu.Request[X]`` and ``Steps[X]``."""

    def on_function(self, *, func: Function, **_: Any) -> None:
        """Replace the annotation of a method that a decorator turns into a request."""
        made_by = {str(decorator.value) for decorator in func.decorators}
        if made_by & MAKERS and isinstance(func.returns, ExprSubscript):
            func.returns = func.returns.slice


class NamesOfStubs(Extension):
    """Read the public names of a package from its stub, because ``__all__`` is computed."""

    def on_module_members(self, *, mod: Module, **_: Any) -> None:
        """Set the exports of a package that has an ``__init__.pyi``."""
        stub = Path(str(mod.filepath)).with_suffix(".pyi")
        if stub.exists():
            names = re.findall(r"from \.\w.* as (\w+)", stub.read_text())  # without modules
            mod.exports = sorted(names)
