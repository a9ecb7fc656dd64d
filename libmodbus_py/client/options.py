"""
The options of clients: the rows with types of the client, and the check of all. The other rows are
in `ports.options`.
"""

# Annotations are values here, as in `ports.options`.
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, cast

from ..ports.hosts import split_host_and_port
from ..ports.options import (
    SERIAL_OPTIONS,
    ConnectionOptions,
    Option,
    SerialSettings,
    optional,
    parity_of,
    rows_of,
)
from ..ports.schemes import options_of
from ..protocol.checks import checked_callback
from ..protocol.mistakes import unknown_option

# Programs without a client need none of these, which import dataclasses and inspect.
if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from ..ports.trace import OnTraced
    from .reconnecting import OnState
    from .statistics import Statistics

__all__ = ["AsyncOptions", "Options", "checked_options", "line_options", "listed_options"]


def _statistics(name: str, value: object) -> None:
    from .statistics import Statistics

    if not isinstance(value, Statistics):
        raise TypeError(f"{name} must be Statistics, not {type(value).__name__}")


class Options(ConnectionOptions, SerialSettings, total=False):
    """The options of `Client`; those of serial ports are for URLs of lines only."""

    trace: Annotated[
        "OnTraced | None",
        Option(
            "is called with a `TracedFrame` for each frame. The logger `libmodbus_py.wire` gets "
            "the same at DEBUG.",
            check=optional(checked_callback),
        ),
    ]
    on_state: Annotated[
        "OnState | None",
        Option(
            "is called with each new `State`, and the error that led to it or None. It must not "
            "block.",
            check=optional(checked_callback),
        ),
    ]
    statistics: Annotated[
        "Statistics | None",
        Option(
            "the `Statistics` in which to count; None for new ones. For programs that make several "
            "clients for one endpoint, one after the other.",
            check=optional(_statistics),
        ),
    ]


class AsyncOptions(Options, total=False):
    """The options of `AsyncClient`."""

    may_send: Annotated[
        Callable[[], bool] | None,
        Option(
            "requests are sent only while this function returns True. It is called right before "
            "bytes are sent, and before connecting; while it returns False, requests raise "
            "ModbusConnectionError (EPERM). For several programs of which only one at a time may "
            "send requests. It must not block. `AsyncClient` only.",
            check=optional(checked_callback),
        ),
    ]


def checked_options(
    endpoint: "Endpoint",
    options: Mapping[str, Any],
    kind: type[Options] = AsyncOptions,
    **usual: Any,
) -> AsyncOptions:
    """
    Return all options of a client: its arguments, else those of the URL, else the defaults.

    Args:
        endpoint: the endpoint of the URL.
        options: the options given, without those of a line (`line_options`).
        kind: the options that the client has.
        usual: defaults in place of those in the rows.

    Raises:
        TypeError, ValueError: an option of the wrong name, type or range.
    """
    rows = {name: row for name, row in rows_of(AsyncOptions).items() if name not in SERIAL_OPTIONS}
    names = [name for name in rows if name in kind.__annotations__]
    for name in (*endpoint.client_options, *options):
        if name not in names:
            of_line = () if endpoint.has_transactions else options_of(endpoint.scheme)
            raise unknown_option(name, [*names, *of_line])
    defaults = {name: row.default for name, row in rows.items()}
    settings = {**defaults, **usual, **endpoint.client_options, **options}
    for name, value in settings.items():
        rows[name].check(name, value)
    if not endpoint.has_transactions:
        where = f"on {endpoint.scheme}, whose answers carry no transaction id"
        if settings["max_in_flight"] != 1:
            raise ValueError(f"max_in_flight must be 1 {where}")
        if settings["ids"] != "check":
            raise ValueError(f'ids must be "check" {where}')
    elif settings["ids"] == "ignore" and settings["max_in_flight"] != 1:
        raise ValueError('max_in_flight must be 1 with ids="ignore"')
    elif (
        settings["ids"] == "ignore"
        and endpoint.is_datagram
        and settings["source"]
        and split_host_and_port(settings["source"])[1]
    ):  # a late answer would come to the next socket, which has the same port
        raise ValueError('source must have no port with ids="ignore" on udp')
    return cast("AsyncOptions", settings)


def line_options(
    endpoint: "Endpoint", options: Mapping[str, Any]
) -> "tuple[Endpoint, Mapping[str, Any]]":
    """Return an endpoint with the options that are of its line, and the other options."""
    if endpoint.has_transactions:
        return endpoint, options
    from dataclasses import replace

    of_line = options_of(endpoint.scheme)
    settings = {**endpoint.options}
    settings |= {name: value for name, value in options.items() if name in of_line}
    if "parity" in settings:
        settings["parity"] = parity_of(settings["parity"])
    others = {name: value for name, value in options.items() if name not in of_line}
    return replace(endpoint, options=settings), others


def listed_options(kind: type[Options], **usual: Any) -> str:
    """Return the options of a client with their defaults, for help()."""

    def lines(rows: Mapping[str, Option]) -> Iterator[str]:
        for name, row in rows.items():
            default = repr(usual.get(name, row.default)).replace("'", '"')
            yield f"    {f'{name}={default}':<28}{row.summary}"

    rows = rows_of(kind)
    return "\n".join(
        (
            "Make a client. These are its options, with their defaults; times are in seconds:\n",
            *lines({name: row for name, row in rows.items() if name not in SERIAL_OPTIONS}),
            "\nOn a serial port also; by default, those of the URL:\n",
            *lines(SERIAL_OPTIONS),
        )
    )
