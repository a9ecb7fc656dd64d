"""
Wrong keyword arguments of the methods of clients, each answered with the right one.

A method ends with ``**wrong``, and raises `unexpected` if it contains anything. That costs a call a
fraction of what a decorator would that catches errors, and the method stays a function or a
coroutine function. Type checkers refuse every such argument, because `NoOthers` has no keys.
`public_methods` does the rest, once for a class:

* Arguments without a default get one, `nothing`. Python would otherwise report that an argument is
  missing, before the method sees that its name was misspelt. The checks of arguments refuse it.
* `__wrapped__` is a function with the signature as it is written, without ``**wrong`` and
  `nothing`. help(), inspect.signature() and mocks take the signature from there; nothing calls it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from types import FunctionType
from typing import Any, TypedDict, TypeVar

from ..protocol.mistakes import OTHER_SPELLINGS, close_option, close_to
from .options import Options

__all__ = ["NoOthers", "check_plan_options", "public_methods", "unexpected"]

Class = TypeVar("Class", bound=type)

# The flag of code that has **keywords; the module inspect, which names it, takes long to import.
CO_VARKEYWORDS = 0x08


class NoOthers(TypedDict):
    """The keyword arguments of a method beside those of its signature: none."""


class nothing:
    """The kind of an argument that was not given: errors say "must be ..., not nothing"."""


def unexpected(method: Any, names: Iterable[str], others: Collection[str] = ()) -> TypeError:
    """
    Return the error for keyword arguments that a method does not take.

    Args:
        method: the method of a client.
        names: the names of arguments; the first one that is not among `others` is wrong.
        others: names that the method takes besides those of its signature.
    """
    name = next(name for name in names if name not in others)
    arguments = [*_arguments(method.__func__)[1:], *others]
    options = Options.__annotations__
    spelling = OTHER_SPELLINGS.get(name.lower(), name)
    if spelling not in arguments and spelling in options:
        close = "; " if spelling == name else f"; did you mean {spelling}? "
        close += "it is an argument of the client"
    elif not (close := close_option(name, arguments)) and (close := close_to(name, options)):
        close += " it is an argument of the client"
    method_name = f"{type(method.__self__).__name__}.{method.__name__}()"
    return TypeError(f"{method_name} got an unexpected keyword argument {name!r}{close}")


def check_plan_options(method: Any, options: Mapping[str, Any]) -> None:
    """Raise the error for the first option that is none of a `Plan`."""
    from ..maps.items import PlanOptions

    options_of_plan = PlanOptions.__annotations__
    if not options.keys() <= options_of_plan.keys():
        raise unexpected(method, options, options_of_plan)


def public_methods(owner: str) -> Callable[[Class], Class]:
    """Decorate a class with methods of a client; `owner` is the class that Python's errors name."""

    def decorated(cls: Class) -> Class:
        for name, method in vars(cls).items():
            if isinstance(method, FunctionType) and not name.startswith("__"):
                method.__qualname__ = f"{owner}.{name}"
                if method.__code__.co_flags & CO_VARKEYWORDS:
                    method.__wrapped__ = _as_written(method)  # type: ignore[attr-defined]
                    _add_defaults(method)
        return cls

    return decorated


def _arguments(method: FunctionType) -> tuple[str, ...]:
    """Return the names of the arguments of a method, without those of ``**wrong``."""
    code = method.__code__
    return code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]


def _as_written(method: FunctionType) -> FunctionType:
    """Return a function with the signature of a method, without ``**wrong``."""
    code, annotations = method.__code__, {**method.__annotations__}
    if annotations.pop("wrong", None):
        code = code.replace(co_flags=code.co_flags & ~CO_VARKEYWORDS)
    function = FunctionType(code, {}, method.__name__, method.__defaults__)
    function.__kwdefaults__, function.__annotations__ = method.__kwdefaults__, annotations
    return function


def _add_defaults(method: FunctionType) -> None:
    """Set a default for each argument of a method, but for `self`."""
    positional = method.__code__.co_argcount
    defaults = method.__defaults__ or ()
    method.__defaults__ = (nothing(),) * (positional - 1 - len(defaults)) + defaults
    by_name = dict.fromkeys(_arguments(method)[positional:], nothing())
    method.__kwdefaults__ = {**by_name, **(method.__kwdefaults__ or {})}
