"""Public names of packages, imported when they are first used (PEP 562)."""

from __future__ import annotations

import sys
from itertools import pairwise

TYPE_CHECKING = False  # imports for type checkers alone would delay every start
if TYPE_CHECKING:
    from collections.abc import Iterator


class Public:
    """
    The public names of a package, as the imports in its stub, ``__init__.pyi``, list them.

    Type checkers read the same stub, so that each name is written once.

    Args:
        package: the name of the package.
        file: the path of its ``__init__.py``.

    Attributes:
        names: the public names, except those of modules.
        modules: the public modules, which the stub imports with ``from . import``.
    """

    def __init__(self, package: str, file: str) -> None:
        with open(f"{file.rpartition('.')[0]}.pyi", encoding="utf-8") as stub:
            self._homes = {name: home for name, *home in _imports(stub.read())}
        self._package = package
        public = sorted(name for name in self._homes if name[0] != "_")
        self.names: list[str] = [name for name in public if self._homes[name][0] != "."]
        self.modules: list[str] = [name for name in public if self._homes[name][0] == "."]

    def named(self, name: str) -> object:
        """
        Import a name: the ``__getattr__`` of the package.

        Raises:
            AttributeError: the stub does not have the name.
            ImportError: its module fails with an AttributeError, or does not have it.
        """
        if name not in self._homes:
            raise AttributeError(f"module {self._package!r} has no attribute {name!r}")
        module, name_there = self._homes[name]
        value = self._module(name_there) if module == "." else self._value(module, name_there)
        setattr(sys.modules[self._package], name, value)  # the next use finds it there
        return value

    def _module(self, name: str) -> object:
        __import__(f"{self._package}.{name}")
        return sys.modules[f"{self._package}.{name}"]

    def _value(self, module: str, name: str) -> object:
        # The name is that of an attribute or of a module, as after "from".
        try:
            return getattr(__import__(self._package + module, fromlist=(name,)), name)
        except AttributeError as error:
            # Python's "from" would hide it, and name the package, which has the name.
            raise ImportError(f"cannot import {self._package}{module}: {error}") from error


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
