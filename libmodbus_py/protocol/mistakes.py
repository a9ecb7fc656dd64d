"""
Errors about arguments: about wrong values, with the path of the value; and about names that do not
exist, with those that are close to them.

An argument, or a key of a file, is found by its path: names and 0-based indices, such as
``("route", 0, "units")``. The caller of a check adds the outer part of the path; the path becomes
text when the error is printed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import wraps
from typing import Any, ParamSpec, Self, TypeVar

Path = tuple[str | int, ...]
Class = TypeVar("Class", bound=type)
Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


class Mistake(Exception):
    """
    An argument, or a key of a file, has a value that it cannot have.

    The message is the path, `between` and the reason, such as "must be in 0..255, not 300".
    """

    def __init__(self, path: str | Path, reason: str, between: str = " ") -> None:
        super().__init__(path, reason, between)
        self.path: Path = (path,) if isinstance(path, str) else path
        self.reason: str = reason
        self.between: str = between

    @classmethod
    def about(cls, path: str | Path, reason: str) -> Self:
        """Return an error whose reason is a sentence of its own, such as "4 is given twice"."""
        return cls(path, reason, ": ")

    def under(self, around: Path) -> Mistake:
        """Return the same error with a longer path."""
        return type(self)((*around, *self.path), self.reason, self.between)

    def renamed(self, path: Path) -> Mistake:
        """Return the same error with `path` in place of the name that its path begins with."""
        return type(self)((*path, *self.path[1:]), self.reason, self.between)

    def __str__(self) -> str:
        return f"{path_text(self.path)}{self.between}{self.reason}" if self.path else self.reason


class WrongValue(Mistake, ValueError):
    """A `Mistake` that is a ValueError."""


class Problem(str):
    """A line about a file that was read again and cannot be used, or not without a restart."""

    __slots__ = ()


class WrongType(Mistake, TypeError):
    """A `Mistake` that is a TypeError."""


def item(path: str | Path, at: int) -> Path:
    """Return the path of an item of a list."""
    return (path, at) if isinstance(path, str) else (*path, at)


def path_text(path: Path) -> str:
    """Return a path as messages have it: ``route[0].units``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def placed(error: Exception, around: Path) -> Mistake:
    """Return a TypeError or ValueError about what lies below a path, with the whole path."""
    if isinstance(error, Mistake):
        return error.under(around)
    kind: type[Mistake] = WrongType if isinstance(error, TypeError) else WrongValue
    return kind.about(around, str(error))


@contextlib.contextmanager
def inside(*around: Any) -> Iterator[None]:
    """Add a path to each TypeError and ValueError of a block."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise placed(error, around) from None


def explain_reference(address: object, function: int | None = None) -> str:
    """Return which address is meant if one of a function, or of any, looks like a reference."""
    digits = "134" if function is None else {2: "1", 3: "4", 4: "3", 6: "4", 16: "4"}.get(function)
    text = str(address) if isinstance(address, int) else ""
    if not digits or text[:1] not in digits or len(text) != (6 if function is None else 5):
        return ""
    item_number = int(text[1:])  # counted from 1, up to 65536 (PI-MBUS-300)
    is_item = 0 < item_number <= 1 << 16
    return f"if {text} is a reference, its address is {item_number - 1}" if is_item else ""


# --- close names ---------------------------------------------------------------------------

OTHER_SPELLINGS = {
    word: name
    for name, words in {
        "baudrate": "baud baud_rate speed bps",
        "stop_bits": "stopbits stop",
        "data_bits": "bytesize databits byte_size",
        "unit": "slave slave_id device_id unit_id dev_id slaveaddress",
        "timeout": "timeout_s response_timeout read_timeout",
        "retries": "retry retry_count tries",
        "echo": "handle_local_echo local_echo",
        "security": "sslctx ssl tls ssl_context",
        "max_pause": "reconnect_delay_max reconnect_delay",
        "cert": "certificate",  # in URLs
        "ca": "trust",
        "certificate": "certfile cert certificate_file",
        "key": "keyfile key_file private_key",
        "trust": "cafile ca ca_file ca_certs",
        "identification": "identity device_identification",
        "max_connections": "max_clients connections",
        "address": "offset register start",
        "type": "data_type datatype dtype format",
        "order": "byte_order byteorder word_order endian",
        "scale": "multiplier factor gain",
        "interval": "poll_interval period scan_interval",
        "url": "host uri endpoint to",
        "source": "source_address local_address bind",
        "holding_registers": "hr holding registers nb_registers",
        "input_registers": "ir input nb_input_registers",
        "discrete_inputs": "di discrete nb_input_bits",
        "coils": "co bits nb_bits",
    }.items()
    for word in words.split()
}
"""Names of arguments in other packages -> their names here, for errors."""

SERIAL_SETTINGS = frozenset(
    ["baudrate", "parity", "data_bits", "stop_bits", "rs485", "rts_delay", "echo", "silence"]
)
"""Settings that are part of the URL of a serial port, for classes that take none of them."""

URLS = frozenset(("url", "devices", "routes", "security"))
"""Names of arguments beside which a setting of a serial port may be expected."""

HOOKS = frozenset(("before_write", "after_write", "before_read"))
CELLS = frozenset(("coils", "discrete_inputs", "holding_registers", "input_registers"))


def close_to(name: object, names: Iterable[str], prefix: str = "") -> str:
    """Return the end of a message about a name that is not known: those that are close to it."""
    from difflib import get_close_matches

    close = get_close_matches(name, names, 3) if isinstance(name, str) else []
    return f"; did you mean {' or '.join(prefix + other for other in close)}?" if close else ""


def close_option(name: str, names: Collection[str]) -> str:
    """Return the end of a message about an option that is not known: which one may be meant."""
    spelling = OTHER_SPELLINGS.get(name.lower(), name)
    if spelling in names:
        return f"; did you mean {spelling}?"
    if spelling in SERIAL_SETTINGS and not URLS.isdisjoint(names):
        url = f"rtu:///dev/ttyUSB0?{spelling}=..."
        return f"; {spelling} is part of the URL of a serial port: {url}"
    if spelling == "port" and "max_in_flight" in names:
        return "; the port is part of the URL: tcp://HOST:PORT"
    if spelling in ("framer", "method") and "max_in_flight" in names:
        return "; the frames are part of the URL: tcp://, rtu+tcp://, rtu:// or ascii://"
    if spelling in HOOKS and "devices" in names:
        return f"; {spelling} is an argument of the device: Device(mapping, {spelling}=...)"
    if spelling in CELLS and "mapping" in names:
        return f"; {spelling} is an argument of the mapping: Device(Mapping({spelling}=...))"
    return close_to(name, names)


def unknown_option(name: str, names: Sequence[str]) -> TypeError:
    """Return the error for an argument that does not exist, with the name of the one meant."""
    return TypeError(f"{name!r} must be one of {', '.join(names)}{close_option(name, names)}")


def named_arguments(cls: Class) -> Class:
    """Decorate a class so that an argument that it does not take is refused with a close name."""
    class_: Any = cls
    class_.__init__ = named_parameters(class_.__init__)
    return cls


def named_parameters(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function as `named_arguments` decorates a class."""

    @wraps(function)
    def call(*arguments: Parameters.args, **keywords: Parameters.kwargs) -> Result:
        try:
            return function(*arguments, **keywords)
        except TypeError as error:
            is_of_the_call = error.__traceback__ and not error.__traceback__.tb_next
            if is_of_the_call and (mistake := _refused(function, keywords)):
                raise mistake from None
            if is_of_the_call and (hint := _positional(function, arguments)):
                raise TypeError(f"{error}{hint}") from None
            raise

    return call


def _positional(function: Callable[..., object], arguments: Sequence[object]) -> str:
    """Return the end of a message about what stands behind the URL of a client or a server."""
    from inspect import signature

    match [*signature(function).parameters], arguments:
        case ["self", "devices", *_], (_, _, _, *_):
            return "; type Server(device).serve_forever(url)"
        case ["self", "url", "options"], (_, url, setting, *_):
            if "://" in str(url):
                return f"; type the name of the argument, as in unit={setting}"
            is_port = str(url).startswith("/")
            whole = f"rtu://{url}?baudrate={setting}" if is_port else f"tcp://{url}:{setting}"
            return f'; type "{whole}"'
    return ""


def _refused(function: Callable[..., object], keywords: Iterable[str]) -> TypeError | None:
    from inspect import Parameter, signature

    kinds = {name: entry.kind for name, entry in signature(function).parameters.items()}
    several = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    names = [name for name, kind in kinds.items() if name != "self" and kind not in several]
    wrong = [name for name in keywords if name not in names]
    if Parameter.VAR_KEYWORD in kinds.values():  # functions with **options check names themselves
        close = ((name, close_option(name, names)) for name in wrong)
        return next((TypeError(f"there is no {name!r}{end}") for name, end in close if end), None)
    return next((unknown_option(name, names) for name in wrong), None)
