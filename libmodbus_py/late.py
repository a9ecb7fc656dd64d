"""
Public names of packages, imported when they are first asked for (PEP 562).
"""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # what is only for checkers would cost every start
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["late"]


def late(
    package: str, homes: Mapping[str, tuple[str, ...]], modules: Mapping[str, str] | None = None
) -> Callable[[str], object]:
    """
    Make the ``__getattr__`` of a package.

    Args:
        package: its name.
        homes: module in the package -> the names that come from there.
        modules: name -> the module in the package that it is.
    """
    module_of = {name: home for home, names in homes.items() for name in names}

    def __getattr__(name: str) -> object:
        if modules and name in modules:
            value: object = import_module(f".{modules[name]}", package)
        elif name in module_of:
            value = getattr(import_module(f".{module_of[name]}", package), name)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, value)  # the next one who asks finds it at once
        return value

    return __getattr__
