"""
Public names of packages, imported when they are first asked for (PEP 562); and the paths of
modules that have moved.
"""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # what is only for checkers would cost every start
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

__all__ = ["late", "moved"]


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


def moved(package: str, paths: Mapping[str, str]) -> None:
    """
    Let modules be imported by the paths that they had before, with a DeprecationWarning.

    Args:
        package: its name.
        paths: old path in the package -> new path; modules below an old path are found below
            the new one.
    """
    # Python asks the last finder for what would be a ModuleNotFoundError, and for nothing else.
    sys.meta_path.append(
        _Moved({f"{package}.{old}": f"{package}.{new}" for old, new in paths.items()})
    )


class _Moved:
    """A finder of modules by their old paths."""

    def __init__(self, paths: Mapping[str, str]) -> None:
        self._paths = paths

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to import a module by an old path, None for any other name."""
        old = name
        while old and old not in self._paths:
            old = old.rpartition(".")[0]
        if not old:
            return None
        from importlib.machinery import ModuleSpec
        from warnings import warn

        new = self._paths[old] + name[len(old) :]
        warn(f"{name} has moved to {new}", DeprecationWarning, stacklevel=2)
        return ModuleSpec(name, _Known(new))  # type: ignore[arg-type]


class _Known:
    """A loader that gives the module of another name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module as it is known by its own name."""
        module = import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own spec back, which Python has replaced."""
        module.__spec__ = self._spec
