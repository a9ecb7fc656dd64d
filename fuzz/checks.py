"""
What must hold for any bytes, for whoever thinks of bytes: Hypothesis or atheris.

Each check raises AssertionError, or lets out what should not have been raised.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from libmodbus_py import Device, FrameError, InvalidResponse, Mapping, device_file, pdu
from libmodbus_py.files.texts import read_toml
from libmodbus_py.maps import map_file
from libmodbus_py.maps.list_words import ListOptions
from libmodbus_py.protocol.errors import (
    ExceptionResponse,
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
)
from libmodbus_py.protocol.framing import (
    AsciiFramer,
    Frame,
    Framer,
    RtuFramer,
    TcpFramer,
    UdpFramer,
)
from libmodbus_py.security.certificates import RoleError, decode_role, encode_role, role_of
from libmodbus_py.services.fleet import files as fleet_files
from libmodbus_py.services.gateway import config as gateway_file
from libmodbus_py.tools.listener.separator import LineFraming, Separator
from libmodbus_py.tools.listener.transaction import TimedFrame

__all__ = [
    "FILES",
    "FRAMERS",
    "REQUEST_OBJECTS",
    "check_certificate",
    "check_datagrams",
    "check_device",
    "check_device_file",
    "check_file",
    "check_listening",
    "check_request",
    "check_response",
    "check_role_value",
    "check_stream",
    "examples",
]

TABLES = {1: "coils", 2: "discrete_inputs", 3: "holding_registers", 4: "input_registers"}
"""Function that reads -> what."""

FRAMERS: dict[str, Callable[[], Framer]] = {
    "tcp": TcpFramer,
    "rtu server": partial(RtuFramer, role="server"),
    "rtu client": partial(RtuFramer, role="client"),
    "ascii": AsciiFramer,
}
"""The framers of streams."""

# The longest beginning of a frame that is worth waiting for.
PENDING = {"tcp": 260, "rtu server": 264, "rtu client": 256, "ascii": 513}


_FILE = Path(__file__).parents[1] / "tests" / "support" / "vectors.json"
_EXAMPLES = [example for example in json.loads(_FILE.read_text()) if "tcp" in example]


def examples(form: str) -> list[bytes]:
    """Return the worked examples of the specification: "pdu", "tcp", "rtu" or "ascii"."""
    found = [example[form] for example in _EXAMPLES]
    return [text.encode() if form == "ascii" else bytes.fromhex(text) for text in found]


Found = list[Frame | FrameError]


def check_stream(name: str, stream: bytes, sizes: Sequence[int]) -> None:
    """
    Frames were on the wire, and it does not matter in which pieces.

    How many errors there are may depend on it: a framer reports at once what it
    cannot use, and more of the same may follow. Where they are among the frames may not.
    """
    whole, rest = _scan(name, [stream])
    assert _outline(whole) == _outline(_scan(name, _pieces(stream, sizes))[0])
    encode = FRAMERS[name]().encode
    seen = stream.upper() if name == "ascii" else stream
    for frame in whole:
        if isinstance(frame, Frame):
            adu = encode(frame)
            if name == "ascii":
                adu = adu[:-2]  # either byte of its end may be missing
            assert adu in seen
            seen = seen[seen.index(adu) + len(adu) :]
    assert rest <= PENDING[name]


def check_datagrams(datagrams: Sequence[bytes]) -> None:
    """Each datagram is one frame or one error, whatever came before: none is cut or joined."""
    framer = UdpFramer()
    for datagram in datagrams:
        found = framer.scan(datagram)
        assert _outline(found) == _outline(UdpFramer().scan(datagram))
        assert len(found) == bool(datagram)
        assert framer.pending == 0
        assert framer.in_step
        for frame in found:
            assert isinstance(frame, FrameError) or framer.encode(frame) == datagram


def check_listening(framing: LineFraming, pieces: Sequence[tuple[float, bytes]]) -> None:
    """
    Whatever is on a line and whenever it comes, nothing is raised.

    On RTU each byte is part of a frame or of damage, once and in its order.

    Args:
        framing: "rtu" or "ascii".
        pieces: bytes, and how many seconds behind the ones before them.
    """
    heard: list[TimedFrame] = []
    separator = Separator(framing, heard.append)
    now, done = 0.0, []
    for gap, piece in pieces:
        now += gap
        done += separator.feed(piece, now)
    done += separator.tick(now + 100) + separator.end()
    for entry in done:
        assert str(entry)
    times = [message.ended for message in heard]
    assert times == sorted(times)
    if framing == "rtu":
        encode = RtuFramer("server").encode
        parts = [encode(message.frame) if message.frame else message.data for message in heard]
        assert b"".join(parts) == b"".join(piece for _, piece in pieces)


def _scan(name: str, pieces: Sequence[bytes]) -> tuple[Found, int]:
    """Everything found, silence at the end included, and how much was pending before."""
    framer = FRAMERS[name]()
    found: Found = []
    for piece in pieces:
        found += framer.scan(piece)
        assert framer.pending <= PENDING[name]
    pending = framer.pending
    return found + framer.scan_silence(), pending


def _pieces(stream: bytes, sizes: Sequence[int]) -> list[bytes]:
    pieces, at = [], 0
    for size in sizes:
        pieces.append(stream[at : at + size])
        at += size
    return [*pieces, stream[at:]]


def _outline(found: Found) -> list[Frame | None]:
    """Return the frames, and None in the place of each error."""
    frames = [entry if isinstance(entry, Frame) else None for entry in found]
    return [entry for key, run in groupby(frames) for entry in ([None] if key is None else run)]


def check_device_file(text: str) -> None:
    """A file gives devices whose values can be read at any time, or one error of one line."""
    moment = [0.0]
    message = ""
    devices: Device | dict[int, Device] = {}
    try:
        devices = device_file.parse(text, clock=lambda: moment[0]).devices
    except device_file.DeviceFileError as error:
        message = str(error)
    assert "\n" not in message
    for device in devices.values() if isinstance(devices, dict) else [devices]:
        for moment[0] in (0.0, 1.5, 1e9):
            for function in (1, 2, 3, 4):
                table = getattr(device.mapping, TABLES[function])
                for range_ in table.ranges[:20]:
                    request = bytes([function]) + range_.start.to_bytes(2, "big") + b"\0\1"
                    # No rule for it (1), what may only be written (2), copies of bits that
                    # are not values (4).
                    answer = device.answer(request)
                    assert answer[0] == function or answer[1] in (1, 2, 4), answer


FILES: dict[str, Callable[[str], list[Exception]]] = {
    "map.toml": lambda text: list(
        map_file.contents_of_text(text, ".toml", 20, ListOptions()).mistakes
    ),
    "map.csv": lambda text: list(
        map_file.contents_of_text(text, ".csv", 20, ListOptions()).mistakes
    ),
    "gateway.toml": lambda text: _mistakes(lambda: gateway_file.parse(text)),
    "fleet.toml": lambda text: _mistakes(lambda: fleet_files.FILE.read((), read_toml(text))),
    "devices.csv": lambda text: _mistakes(lambda: _devices(text)),
}
"""Kind of file -> returns what is wrong in a text."""


def _of_map(text: str, suffix: str) -> list[Exception]:
    return [*map_file.contents_of_text(text, suffix, 20, ListOptions()).mistakes]


def _devices(text: str) -> list[dict[str, Any]]:
    table = fleet_files.table_of(text)
    return [fleet_files.keys_in(table, row) for row in table.rows()]


def _mistakes(read: Callable[[], object]) -> list[Exception]:
    try:
        read()
    except (TypeError, ValueError) as error:
        return [error]
    return []


def check_file(kind: str, text: str) -> None:
    """A file is read, or each of its mistakes is one line."""
    for error in FILES[kind](text):
        assert "\n" not in str(error)


def check_request(data: bytes) -> None:
    """A PDU is decoded and encodes to the same bytes, or is refused."""
    request = _attempt(pdu.decode_request, data)
    if isinstance(request, ExceptionResponse):
        assert type(request) in (IllegalFunction, IllegalDataAddress, IllegalDataValue)
        assert data
    elif isinstance(request, ValueError):
        assert not data
    else:
        assert isinstance(request, pdu.Request)
        again = request.encode()
        # The bits behind the last coil are the sender's own.
        assert again == data or (data[0] == 15 and again[:-1] == data[:-1])
        assert pdu.decode_request(again) == request
        assert pdu.request_length(data) in (0, len(data))
        assert len(str(request)) < 1000


def _attempt(decode: Callable[[bytes], Any], data: bytes) -> Any:
    """Return the result of a decoder, or the exception that it raises."""
    try:
        return decode(data)
    except (ExceptionResponse, InvalidResponse, ValueError) as error:
        return error


def _one_of_each() -> list[pdu.Request[Any]]:
    """A request of each class, as the examples have them."""
    found: dict[type, pdu.Request[Any]] = {}
    for example in _EXAMPLES:
        if example["kind"] == "request" and example["function"] in pdu.REQUESTS:
            request = pdu.decode_request(bytes.fromhex(example["pdu"]))
            found.setdefault(type(request), request)
    return [*found.values(), pdu.RawRequest(65, b"\1\2")]


REQUEST_OBJECTS = _one_of_each()


def check_response(request: pdu.Request[Any], data: bytes) -> None:
    """A PDU is decoded and its result encodes and decodes again, or an error has the reason."""
    result = _attempt(request.decode_response, data)
    if isinstance(result, ExceptionResponse):
        assert data[0] == request.function | 0x80
        assert result.code in data[1:]
        assert len(data) == 2 or (len(data) == 3 and request.function == 0x2B)
    elif isinstance(result, InvalidResponse):
        assert result.function == request.function
    else:
        assert not isinstance(result, ValueError)
        assert data[0] == request.function
        if len(data) <= pdu.MAX_PDU and getattr(result, "complete", True):
            assert request.decode_response(request.encode_response(result)) == result


def new_device() -> Device:
    """Make a device with a bit of everything."""
    mapping = Mapping(
        coils=range(10, 2100),
        discrete_inputs=range(20, 2100),
        holding_registers=range(100, 400),
        input_registers=range(0xFF00, 0x10000),
    )
    return Device(
        mapping,
        files={4: range(200), 3: {9: 0x33CD, 10: 0x0040, 12: 7}},
        fifos={0x04DE: [440, 4740], 1: range(31)},
        identification={"VendorUrl": "http://example.com", 0x80: b"\0" * 244},
        canopen=lambda data: data,
    )


def check_device(requests: Sequence[bytes]) -> None:
    """Each request is answered unless it must not be; and every cell is still valid."""
    device = new_device()
    for request in requests:
        answer = device.answer(request)
        if not answer:
            assert request[0] & 0x80
        elif answer[0] & 0x80:
            assert answer[0] == request[0] | 0x80
            assert len(answer) == 2
            assert answer[1] in (1, 2, 3), answer[1]
        else:
            assert answer[0] == request[0]
            assert len(answer) <= pdu.MAX_PDU
            pdu.decode_request(request).decode_response(answer)
    cells = bytes(device.mapping.coils.view) + bytes(device.mapping.discrete_inputs.view)
    assert not cells.strip(b"\0\1")


def check_role_value(value: bytes) -> str | None:
    """Each role has one encoding, so that all programs read the same; or an error."""
    try:
        role = decode_role(value)
    except RoleError as error:
        _check_message(str(error))
        return None
    assert encode_role(role) == value
    return role


def check_certificate(data: bytes) -> None:
    """A certificate has a role or none, or an error of one line fit for a log."""
    try:
        role = role_of(data)
    except RoleError as error:
        _check_message(str(error))
        return
    assert role is None or encode_role(role) in data


def _check_message(text: str) -> None:
    assert text.isprintable()
    assert len(text) < 300
