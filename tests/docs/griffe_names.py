"""
For mkdocstrings: the arguments of client methods, and the public names of packages with a stub.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from griffe import Extension, Function, Module


class ArgumentsOfMethods(Extension):
    """Show the arguments of a client method without ``**wrong``, which takes none."""

    def on_function(self, *, func: Function, **_: Any) -> None:
        """Drop the parameter that only serves errors."""
        if "wrong" in func.parameters:
            del func.parameters["wrong"]


class NamesOfStubs(Extension):
    """Read the public names of a package from its stub, because ``__all__`` is computed."""

    def on_module_members(self, *, mod: Module, **_: Any) -> None:
        """Set the exports of a package that has an ``__init__.pyi``."""
        stub = Path(str(mod.filepath)).with_suffix(".pyi")
        if stub.exists():
            names = re.findall(r"from \.\w.* as (\w+)", stub.read_text())  # without modules
            mod.exports = sorted(names)
