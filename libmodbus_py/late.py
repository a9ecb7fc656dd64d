"""
Public names of packages, imported when they are first used (PEP 562); and the former paths of
modules.
"""

from __future__ import annotations

import sys
from importlib import import_module
from itertools import pairwise

TYPE_CHECKING = False  # imports for type checkers alone would delay every start
if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

__all__ = ["Public", "moved"]

# In a stub, the names below this line are kept for programs that still use them.
FORMER = "# isort: split"


class Public:
    """
    The public names of a package, as the imports in its stub, ``__init__.pyi``, list them.

    Type checkers read the same stub, so that each name is written once.

    Args:
        package: the name of the package.
        file: the path of its ``__init__.py``.

    Attributes:
        names: the public names, without the former ones.
    """

    def __init__(self, package: str, file: str) -> None:
        with open(f"{file.rpartition('.')[0]}.pyi", encoding="utf-8") as stub:
            current, _, former = stub.read().partition(FORMER)
        self._package = package
        self._homes = {name: home for name, *home in _imports(current)}
        self._former = {name: home for name, *home in _imports(former)}
        self.names: list[str] = sorted(name for name in self._homes if name[0] != "_")

    def named(self, name: str) -> object:
        """
        Import a name: the ``__getattr__`` of the package.

        Raises:
            AttributeError: the stub does not have the name.
            ImportError: its module fails with an AttributeError, or does not have it.
        """
        if home := self._homes.get(name):
            value = self._value(*home)
            setattr(sys.modules[self._package], name, value)  # the next use finds it there
            return value
        if home := self._former.get(name):
            from warnings import warn

            value = self._value(*home)
            module, present = home[0], getattr(value, "__name__", name)
            warn(
                f"{self._package}.{name} is now {self._package}{module}.{present}",
                DeprecationWarning,
                stacklevel=2,
            )
            return value
        raise AttributeError(f"module {self._package!r} has no attribute {name!r}")

    def _value(self, module: str, name: str) -> object:
        # The name is that of an attribute or of a module, as after "from".
        try:
            return getattr(__import__(self._package + module, fromlist=(name,)), name)
        except AttributeError as error:
            # Python's "from" would hide it, and name the package, which has the name.
            text = f"cannot import {self._package}{module}: {error}"
            raise ImportError(text) from error


def _imports(stub: str) -> Iterator[tuple[str, str, str]]:
    """Yield public name, module and the name there of each ``from .MODULE import NAME as NAME``."""
    words = stub.translate(str.maketrans("(),", "   ")).split()
    module = name = ""
    for word, following in pairwise(words):
        if word == "from":
            module = following
        elif word == "as" and module.startswith("."):
            yield following, module, name
        name = word


def moved(package: str, paths: Mapping[str, str]) -> None:
    """
    Let modules be imported by their former paths, with a DeprecationWarning.

    Args:
        package: the name of the package.
        paths: former path in the package -> present path; modules below a former path are found
            below the present one.
    """
    # Python asks the last finder only for a module that no other finder has found.
    sys.meta_path.append(
        _Moved({f"{package}.{old}": f"{package}.{new}" for old, new in paths.items()})
    )


class _Moved:
    """A finder of modules by their former paths."""

    def __init__(self, paths: Mapping[str, str]) -> None:
        self._paths = paths

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to import the module with a former path, or None for any other name."""
        former = name
        while former and former not in self._paths:
            former = former.rpartition(".")[0]
        if not former:
            return None
        from importlib.machinery import ModuleSpec
        from warnings import warn

        present = self._paths[former] + name[len(former) :]
        warn(f"{name} has moved to {present}", DeprecationWarning, stacklevel=2)
        return ModuleSpec(name, _Present(present))  # type: ignore[arg-type]


class _Present:
    """A loader that returns the module of another name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module of the present name, or what stands for it if it is a folder."""
        module = import_module(self._name)
        self._spec = module.__spec__
        return _stand_in(spec, module) if hasattr(module, "__path__") else module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own spec, which the import system has just replaced."""
        if module.__name__ == self._name:
            module.__spec__ = self._spec


def _stand_in(spec: ModuleSpec, folder: ModuleType) -> ModuleType:
    # With a path, Python would load the files below the folder a second time.
    module = type(sys)(spec.name, folder.__doc__)
    module.__path__ = []
    module.__getattr__ = lambda name: getattr(folder, name)  # type: ignore[method-assign]
    return module
