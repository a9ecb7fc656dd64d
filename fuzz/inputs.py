"""
Inputs of a fuzzer: how each target reads the bytes, and first examples.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from fuzz.checks import (
    FILES,
    FRAMERS,
    REQUEST_OBJECTS,
    check_certificate,
    check_datagrams,
    check_device,
    check_device_file,
    check_file,
    check_listening,
    check_request,
    check_response,
    check_role_value,
    check_stream,
    examples,
)
from libmodbus_py.security.certificates import encode_role
from libmodbus_py.tools.certificates import make
from libmodbus_py.tools.listener.separator import LineFraming

__all__ = ["TARGETS", "Target"]

GAPS = (0.0, 0.005, 0.05, 2.0)


def framers(data: bytes) -> None:
    """Which framer, the sizes of eight pieces, the stream; or UDP and sized datagrams."""
    names = [*FRAMERS]
    if not data:
        return
    which, data = data[0] % (len(names) + 1), data[1:]
    if which < len(names):
        check_stream(names[which], data[8:], data[:8])
    else:
        check_datagrams(_sized(data))


def some_framers() -> list[bytes]:
    forms = {"tcp": "tcp", "rtu server": "rtu", "rtu client": "rtu", "ascii": "ascii"}
    streams = [
        bytes([which]) + bytes(range(8)) + example
        for which, name in enumerate(FRAMERS)
        for example in examples(forms[name])
    ]
    datagrams = [bytes([len(FRAMERS)]) + _with_sizes([item, item]) for item in examples("tcp")]
    return streams + datagrams


def pdus(data: bytes) -> None:
    """The number of the request that the PDU answers, or none; then the PDU."""
    if not data:
        return
    which, data = data[0] % (len(REQUEST_OBJECTS) + 1), data[1:]
    if which < len(REQUEST_OBJECTS):
        check_response(REQUEST_OBJECTS[which], data)
    else:
        check_request(data)


def some_pdus() -> list[bytes]:
    functions = [request.function for request in REQUEST_OBJECTS]
    return [
        bytes([which]) + example
        for example in examples("pdu")
        for which, function in enumerate([*functions, example[0]])
        if function == example[0] & 0x7F
    ]


def devices(data: bytes) -> None:
    """Requests, each after its size."""
    check_device([request for request in _sized(data) if 1 <= len(request) <= 253])


def some_devices() -> list[bytes]:
    every = examples("pdu")
    return [_with_sizes(every[at : at + 4]) for at in range(len(every))]


def device_files(data: bytes) -> None:
    """Text in UTF-8; invalid bytes are replaced by letters."""
    check_device_file(data.decode("utf-8", "replace"))


def some_device_files() -> list[bytes]:
    """The example, and each of its tables with the unit that it stands in."""
    text = (Path(__file__).parents[1] / "examples" / "plant.toml").read_bytes()
    tables = text.split(b"\n[")[1:]
    return [text, *(b"[[unit]]\n[" + table for table in tables)]


def files(data: bytes) -> None:
    """The kind of the file, and its text."""
    kind = sorted(FILES)[data[0] % len(FILES)] if data else "map.toml"
    check_file(kind, data[1:].decode("utf-8", "replace"))


def some_files() -> list[bytes]:
    """The examples, and a list of devices, as every kind of file."""
    folder = Path(__file__).parents[1] / "examples"
    texts = [(folder / name).read_bytes() for name in ("gateway.toml", "fleet.toml", "meter.csv")]
    texts.append(b"name;url;unit;map;labels.site\na;tcp://192.0.2.1;1;meter.csv;here\n")
    texts.append(b'[[point]]\nname = "a"\ntable = "coils"\naddress = 1\n')
    return [bytes([kind]) + text for text in texts for kind in range(len(FILES))]


def lines(data: bytes) -> None:
    """The framing, the sizes and gaps of eight pieces, what is on the line."""
    framing: LineFraming = "ascii" if data[:1] > b"\x7f" else "rtu"
    sizes, stream = data[1:9], data[9:]
    pieces = []
    for size in sizes:
        pieces.append((GAPS[size >> 6], stream[: size & 0x3F]))
        stream = stream[size & 0x3F :]
    check_listening(framing, [*pieces, (0.0, stream)])


def some_lines() -> list[bytes]:
    return [
        head + bytes(range(8, 248, 30)) + b"".join(examples(form)[at : at + 4])
        for head, form in ((b"\0", "rtu"), (b"\xff", "ascii"))
        for at in range(len(examples(form)))
    ]


def _sized(data: bytes) -> list[bytes]:
    parts = []
    while data:
        parts.append(data[1 : 1 + data[0]])
        data = data[1 + data[0] :]
    return parts


def _with_sizes(parts: list[bytes]) -> bytes:
    return b"".join(bytes([len(part)]) + part for part in parts)


def some_chunks() -> list[bytes]:
    """For chunk.c: the unit of the device, the room for answers, the chunk."""
    every = examples("tcp")
    glued = [b"".join(every[at : at + 4]) for at in range(len(every))]
    return [bytes([stream[6], 0x40]) + stream for stream in every + glued]


def certificates(data: bytes) -> None:
    """Return the value of a role extension, and a whole certificate."""
    check_role_value(data)
    check_certificate(data)


def some_certificates() -> list[bytes]:
    roles = ["Operator", "x", "ä" * 100]
    made = [make("seed", role=role, hosts=["localhost", "::1"]).der for role in (None, *roles)]
    return [encode_role(role) for role in roles] + made


class Target(NamedTuple):
    """
    What is fuzzed.

    Attributes:
        check: raises if the input shows a defect; None if it is not Python's to call.
        seeds: gives the inputs to begin with.
    """

    check: Callable[[bytes], None] | None
    seeds: Callable[[], list[bytes]]


TARGETS = {
    "framers": Target(framers, some_framers),
    "pdu": Target(pdus, some_pdus),
    "listener": Target(lines, some_lines),
    "device": Target(devices, some_devices),
    "certificates": Target(certificates, some_certificates),
    "device_file": Target(device_files, some_device_files),
    "files": Target(files, some_files),
    "chunk": Target(None, some_chunks),
}
