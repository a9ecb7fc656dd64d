"""
The options of clients, each in one row. What clients take, check and list in help(), the options of
URLs, those of the command line and docs/defaults.md are made of these rows.

A row is the annotation of a key: its type, which editors and type checkers see, its text, and an
`Option`.
The rows of what only clients know are in `client.options`.
"""

# Annotations are values here, so `annotations` of `__future__` is not imported.
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeAlias, TypedDict

from ..protocol.checks import DURATION, checked_callback, duration_of, integer, seconds

if TYPE_CHECKING:
    from ..security.security import GivenContext, Security


# A check of a name and a value: TypeError or ValueError.
Check: TypeAlias = Callable[[str, Any], object]


class Form(NamedTuple):
    """The form of an option in URLs and on the command line."""

    convert: Callable[[str], Any]  # or ValueError
    wanted: str  # the allowed texts, for errors
    placeholder: str  # for the value in --help; empty for a switch

    def option(self, default: Any = None, check: Check = lambda name, value: None) -> "Option":
        """Return an option of this form, whose text stands beside it in its row."""
        return Option("", self, default, check)


OBJECT = Form(str, "an object", "")
"""The form of what only programs can give."""


class Option(NamedTuple):
    """An option; the first sentence of its text is what help() and --help show."""

    text: str
    form: Form = OBJECT
    default: Any = None
    check: Check = lambda name, value: None

    @property
    def summary(self) -> str:
        """The first sentence of the text, without its full stop."""
        return self.text.partition(". ")[0].removesuffix(".")


def rows_of(options: type) -> dict[str, Option]:
    rows: dict[str, Option] = {}
    for name, kind in options.__annotations__.items():
        *texts, option = kind.__metadata__
        rows[name] = option._replace(text=texts[0]) if texts else option
    return rows


# --- forms in URLs --------------------------------------------------------------------------


def _switch(text: str) -> bool:
    return ("0", "1", "false", "true").index(text.lower()) % 2 == 1


PARITIES = {"none": "N", "even": "E", "odd": "O", "n": "N", "e": "E", "o": "O"}
"""Word -> parity, as serial ports take it."""


def parity_of(word: object) -> Any:
    """Return the parity of a word, such as "N" for "none" or "n", or raise ValueError."""
    if not isinstance(word, str) or word.lower() not in PARITIES:
        raise ValueError(f'parity must be "N", "E" or "O", not {word!r}')
    return PARITIES[word.lower()]


def _text(placeholder: str) -> Form:
    return Form(str, "text", placeholder)


NUMBER = Form(int, "a number", "N")
ANY_NUMBER = Form(partial(int, base=0), "a number such as 10 or 0x0A", "N")
SECONDS = Form(duration_of, DURATION, "S")
SECONDS_OR_NONE = Form(
    lambda text: None if text == "none" else duration_of(text), f"{DURATION}, or none", "S"
)
PARITY = Form(parity_of, "none, even or odd", "P")
SWITCH = Form(_switch, "0 or 1", "")
FILE, NAME = _text("FILE"), _text("NAME")


# --- checks ---------------------------------------------------------------------------------


def integers(low: int, high: int) -> Check:
    return partial(integer, low=low, high=high)


def durations(low: float = 0, high: float = 86_400) -> Check:
    return partial(seconds, low=low, high=high)


def optional(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


def one_of(*words: str) -> Check:

    def check(name: str, value: object) -> None:
        if value not in words:
            *others, last = (f'"{word}"' for word in words)
            raise ValueError(f"{name} must be {', '.join(others)} or {last}, not {value!r}")

    return check


def _flag(name: str, value: object) -> None:
    if not isinstance(value, bool):
        raise TypeError(f"{name} must be True or False, not {value!r}")


RS485_MODES = ("kernel", "rts-up", "rts-down")

GPIO_LINE = re.compile("gpio:(/.+)/([^/]+)")
"""The chip and the number or name of a line, as in "gpio:/dev/gpiochip0/17"."""


def _rs485(name: str, value: object) -> None:
    if not isinstance(value, str):
        checked_callback(name, value)
    elif value not in RS485_MODES and not GPIO_LINE.fullmatch(value):
        raise ValueError(
            f'{name} must be "kernel", "rts-up", "rts-down", a function, or a line such as '
            f'"gpio:/dev/gpiochip0/17", not {value!r}'
        )


def _echo(name: str, value: object) -> None:
    if not isinstance(value, bool | None):
        raise TypeError(f"{name} must be True, False or None, not {value!r}")


def _delimiter(name: str, value: object) -> None:
    from ..protocol.framing import is_delimiter  # programs that only parse URLs need no frames

    if not is_delimiter(integer(name, value, 0, 0xFF)):
        raise ValueError(f"{name} must be an ASCII code with no other use, not {value}")


def _source(name: str, value: object) -> None:
    from .hosts import own_address  # programs that only parse options need no sockets

    own_address(name, value)


COUNT = re.compile("([0-9]{1,4}) ?bytes?")


def greeting_of(name: str, value: object) -> tuple[int, tuple[bytes, ...]]:
    """
    Return how many bytes a device sends when it has connected, and which texts it sends then or
    between frames. An error names the option.
    """
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, not {type(value).__name__}")
    count, texts = 0, []
    for item in value.split(","):
        if number := COUNT.fullmatch(item):
            count += int(number[1])
        elif item.startswith("0x"):
            try:
                texts.append(bytes.fromhex(item[2:]))
            except ValueError:
                raise ValueError(
                    f"{name} must have pairs of hex digits after 0x, not {item!r}"
                ) from None
        else:
            texts.append(item.encode())
    if b"" in texts:
        raise ValueError(
            f'{name} must be such as "20 bytes", "www.example" or "0x0d0a", not {value!r}'
        )
    return count, tuple(texts)


def _security(name: str, value: object) -> None:
    from ..security.security import GivenContext, Security  # this imports ssl, which takes long

    if not isinstance(value, Security | GivenContext):
        raise TypeError(f"{name} must be Security, not {type(value).__name__}")


# --- rows -----------------------------------------------------------------------------------

Parity = Literal["N", "E", "O", "none", "even", "odd"]
Rs485: TypeAlias = str | Callable[[bool], object]


class ConnectionOptions(TypedDict, total=False):
    """The options of all clients, but for those of serial ports and of `client.options`."""

    unit: Annotated[
        int,
        "the unit to which requests are sent, 0..255. 0 is a broadcast on serial lines: only "
        "writes can be sent, and they return after the turnaround.",
        NUMBER.option(1, integers(0, 255)),
    ]
    timeout: Annotated[
        float,
        "seconds that a request may take, connecting included, 0.001..86400. They run from the "
        "call to the end of the response, without the time in which it waits for others.",
        SECONDS.option(1.0, durations(0.001)),
    ]
    retries: Annotated[
        int,
        "how often a request is sent again without a good response, 0..100. That is after no "
        "response, a damaged one or a lost connection, and only if the request may be sent "
        "twice (`pdu.Request.repeatable`).",
        NUMBER.option(0, integers(0, 100)),
    ]
    busy_retries: Annotated[
        int,
        "how often a request is sent again that a device refuses as busy, 0..100. That is with "
        "Acknowledge or ServerDeviceBusy; the pauses are 0.1, 0.2, 0.4, 0.8, 1, 1... s.",
        NUMBER.option(0, integers(0, 100)),
    ]
    # The buffers of two sockets hold 256 requests and answers of full length. With more, each side
    # might wait for the other one to read before it goes on.
    max_in_flight: Annotated[
        int,
        "the most reads in flight, 1..256. A write is always alone. Only 1 where frames carry "
        "no transaction id. Many devices lose requests that arrive together; servers need not "
        "accept more than 16 (TCP guide, 4.3.3).",
        NUMBER.option(1, integers(1, 256)),
    ]
    turnaround: Annotated[
        float,
        "seconds that a broadcast takes. So does every request that gets no response (serial "
        "line, 2.4.1).",
        SECONDS.option(0.1, durations()),
    ]
    broadcast: Annotated[
        bool,
        "unit 0 of a serial line is a broadcast. False if a device answers as unit 0, as some "
        "do that are alone on the line.",
        SWITCH.option(True, _flag),
    ]
    request_spacing: Annotated[
        float,
        "the least seconds between the starts of two requests. For devices that need a pause; "
        "it does not count towards `timeout`. A slow answer shortens the pause behind it; on "
        "lines, `silence` counts from the end of the answer.",
        SECONDS.option(0.0, durations()),
    ]
    connect_delay: Annotated[
        float,
        "seconds between connecting and the first request. For devices that need to get ready; "
        "they do not count towards `timeout`.",
        SECONDS.option(0.0, durations()),
    ]
    timeouts_before_reconnect: Annotated[
        int,
        "timeouts in a row before a new network connection, 1..1000000. Cancelled requests "
        "count; the next request opens it.",
        NUMBER.option(3, integers(1, 1_000_000)),
    ]
    idle_close: Annotated[
        float | None,
        "seconds without a response after which the connection is closed, 0.1..86400, or None. "
        "The next request makes a new one. For devices that close idle connections, or have "
        "one for all clients. A blocking client closes it in `watch`, else before its next "
        "request.",
        SECONDS_OR_NONE.option(None, optional(durations(0.1))),
    ]
    max_pause: Annotated[
        float,
        "the most seconds between two attempts to connect. Pauses begin at 0.1 s and double; "
        "with 0 there are none. 30 by default for `AsyncClient`.",
        SECONDS.option(0.0, durations()),
    ]
    keepalive: Annotated[
        float | None,
        "seconds of silence after which TCP probes the other end, 1..32767, or None. In a URL "
        "it is none.",
        SECONDS_OR_NONE.option(30.0, optional(durations(1, 32_767))),
    ]
    source: Annotated[
        str | None,
        "the address of this machine to connect from, maybe with a port, as 192.0.2.5:40000. "
        "For TCP, TLS and UDP. A TCP connection from a port of its own ends with a reset, so "
        "that the port is free for the next one.",
        _text("ADDRESS").option(check=optional(_source)),
    ]
    greeting: Annotated[
        str | None,
        "what a device that connects to the client sends besides frames, such as 20 bytes. "
        "Several items have commas between them: the number of bytes that it sends first, "
        "texts, and bytes such as 0x0d0a. For listen+tcp:// and listen+rtu+tcp://.",
        _text("ITEMS").option(check=optional(greeting_of)),
    ]
    accept_unit: Annotated[
        Literal["same", "any"],
        'the units whose responses are accepted: "same", the one addressed, or "any". Some '
        "TCP devices answer every request as unit 255. On a line only with one device.",
        _text("WHICH").option("same", one_of("same", "any")),
    ]
    ids: Annotated[
        Literal["check", "ignore"],
        'the transaction ids of responses: "check", or "ignore" to accept any. For devices '
        "that answer with wrong ones, and no request twice. Only with one request in flight; after "
        "a request without an answer a new connection is made, so that a late answer is not taken "
        "for another.",
        _text("WHICH").option("check", one_of("check", "ignore")),
    ]
    write_function: Annotated[
        Literal["auto", "single", "multiple"],
        'the functions that write values: "single" for 5 and 6, "multiple" for 15 and 16, or '
        '"auto". Of `write_map` and `write_value`, for devices that lack functions. With '
        '"single", each coil and register has a request of its own, so that the device sees a '
        'value of two registers in two halves. "auto" writes single coils and registers of '
        "maps with 5 and 6, and several with 15 and 16.",
        _text("WHICH").option("auto", one_of("auto", "single", "multiple")),
    ]
    delimiter: Annotated[
        int,
        "the byte after CR in ASCII frames, 10 for LF. The client uses a new one once it has "
        "set it with `diagnostics(3, ...)`.",
        ANY_NUMBER.option(0x0A, _delimiter),
    ]
    security: Annotated[
        "Security | GivenContext | None",
        "the client's certificate and those it trusts, a `Security`. For tls:// only; the URL "
        "may name the files instead. `GivenContext` is for programs that must use an SSL "
        "context of their own.",
        OBJECT.option(check=optional(_security)),
    ]


class SerialSettings(TypedDict, total=False):
    """The settings of a `SerialPort`."""

    baudrate: Annotated[int, Option("bits per second", NUMBER, 19200, integers(1, 4_000_000))]
    parity: Annotated[
        Parity, Option("parity: none, even or odd", PARITY, "E", lambda _, word: parity_of(word))
    ]
    data_bits: Annotated[int, Option("data bits of a character, 7 or 8", NUMBER, 8, integers(5, 8))]
    stop_bits: Annotated[int, Option("stop bits, 1 or 2", NUMBER, 1, integers(1, 2))]
    rs485: Annotated[
        Rs485 | None,
        "what switches an RS-485 transceiver: kernel, rts-up, rts-down, gpio:CHIP/LINE",
        _text("MODE").option(check=optional(_rs485)),
    ]
    rts_delay: Annotated[
        float | None,
        "seconds between RTS and the data; by default, one character",
        SECONDS.option(check=optional(durations(0, 1))),
    ]
    echo: Annotated[
        bool | None,
        "the line returns all that is sent; by default, this is detected",
        SWITCH.option(check=_echo),
    ]
    silence: Annotated[
        float | None,
        "seconds of silence before a request; by default, 3.5 characters on rtu://",
        SECONDS.option(check=optional(durations(0, 1))),
    ]


CLIENT_OPTIONS: Mapping[str, Option] = {
    name: row for name, row in rows_of(ConnectionOptions).items() if row.form is not OBJECT
}
"""The options of clients that every URL may contain."""

SERIAL_OPTIONS: Mapping[str, Option] = rows_of(SerialSettings)

SERIAL_DEFAULTS: Mapping[str, Any] = {
    name: row.default for name, row in SERIAL_OPTIONS.items() if row.default is not None
}

# ASCII frames are text with delimiters.
ASCII_DEFAULTS: Mapping[str, Any] = {"data_bits": 7, "silence": 0.0}


def character_bits(settings: Mapping[str, Any]) -> int:
    """Return the bits of a character on a line with settings as in `SERIAL_DEFAULTS`."""
    data: int = settings["data_bits"]
    stop: int = settings["stop_bits"]
    return 1 + data + int(settings["parity"] != "N") + stop
