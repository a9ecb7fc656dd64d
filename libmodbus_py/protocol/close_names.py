"""
Names that are close to one that is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from functools import wraps
from typing import ParamSpec, TypeVar

__all__ = [
    "SERIAL_SETTINGS",
    "close_option",
    "close_to",
    "named_arguments",
    "named_parameters",
    "unknown_option",
]

Class = TypeVar("Class", bound=type)
Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

OTHER_SPELLINGS = {
    **dict.fromkeys(("baud", "baud_rate", "speed", "bps"), "baudrate"),
    **dict.fromkeys(("stopbits", "stop"), "stop_bits"),
    **dict.fromkeys(("bytesize", "databits", "byte_size"), "data_bits"),
    **dict.fromkeys(
        ("slave", "slave_id", "device_id", "unit_id", "dev_id", "slaveaddress"), "unit"
    ),
    **dict.fromkeys(("timeout_s", "response_timeout", "read_timeout"), "timeout"),
    **dict.fromkeys(("retry", "retry_count", "tries"), "retries"),
    **dict.fromkeys(("handle_local_echo", "local_echo"), "echo"),
    **dict.fromkeys(("sslctx", "ssl", "tls", "ssl_context"), "security"),
    **dict.fromkeys(("reconnect_delay_max", "reconnect_delay"), "max_pause"),
    **dict.fromkeys(("certfile", "cert", "certificate_file"), "certificate"),
    **dict.fromkeys(("keyfile", "key_file", "private_key"), "key"),
    **dict.fromkeys(("cafile", "ca", "ca_file", "ca_certs"), "trust"),
    **dict.fromkeys(("identity", "device_identification"), "identification"),
    **dict.fromkeys(("max_clients", "connections"), "max_connections"),
    **dict.fromkeys(("offset", "register", "start"), "address"),
    **dict.fromkeys(("data_type", "datatype", "dtype", "format"), "type"),
    **dict.fromkeys(("byte_order", "byteorder", "word_order", "endian"), "order"),
    **dict.fromkeys(("multiplier", "factor", "gain"), "scale"),
    **dict.fromkeys(("poll_interval", "period", "scan_interval"), "interval"),
    **dict.fromkeys(("host", "uri", "endpoint"), "url"),
}
"""Names of arguments in other packages -> their names here, for errors."""


SERIAL_SETTINGS = frozenset(
    ("baudrate", "parity", "data_bits", "stop_bits", "rs485", "rts_delay", "echo", "silence")
)
"""Settings that are part of the URL of a serial port, for classes that take none of them."""

URLS = frozenset(("url", "to", "devices", "routes", "security"))
"""Names of arguments beside which a setting of a serial port may be expected."""


def close_to(name: object, known: Iterable[str], prefix: str = "") -> str:
    """
    Return the end of a message about a name that is not known: those that are close to it.

    Args:
        prefix: printed before each of them.
    """
    from difflib import get_close_matches

    close = get_close_matches(name, known, 3) if isinstance(name, str) else []
    return f"; did you mean {' or '.join(prefix + each for each in close)}?" if close else ""


def close_option(name: str, known: Collection[str]) -> str:
    """Return the end of a message about an option that is not known: which one may be meant."""
    meant = OTHER_SPELLINGS.get(name.lower(), name)
    if meant in known:
        return f"; did you mean {meant}?"
    if meant in SERIAL_SETTINGS and not URLS.isdisjoint(known):
        return f"; {meant} is part of the URL of a serial port: rtu:///dev/ttyUSB0?{meant}=..."
    return close_to(name, known)


def unknown_option(name: str, known: Sequence[str]) -> TypeError:
    """Return the error for an argument that does not exist, with the name of the one meant."""
    return TypeError(f"{name!r} must be one of {', '.join(known)}{close_option(name, known)}")


def named_arguments(cls: Class) -> Class:
    """
    Decorate a class so that an argument that it does not take is refused with a close name.

    Python names close ones itself since 3.13, but none that other packages use.
    """
    made: Callable[..., None] = getattr(cls, "__init__")  # noqa: B009 (as below)

    setattr(cls, "__init__", named_parameters(made))  # noqa: B010 (type checkers refuse an assignment)
    return cls


def named_parameters(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function as `named_arguments` decorates a class."""

    @wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        try:
            return function(*arguments, **named)
        except TypeError as error:
            # Raised by the call itself, not within.
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise
            refused = _refused(function, named)
            if refused is None:
                raise
            raise refused from None

    return call


def _refused(function: Callable[..., object], named: Iterable[str]) -> TypeError | None:
    """Return the error for the first argument that a function does not take, if there is one."""
    from inspect import Parameter, signature

    parameters = [*signature(function).parameters.values()]
    if any(each.kind is Parameter.VAR_KEYWORD for each in parameters):
        return None
    known = [each.name for each in parameters if each.name != "self"]
    return next((unknown_option(name, known) for name in named if name not in known), None)
