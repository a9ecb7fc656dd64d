"""
Requests whose data are sent as they are: of any function, and the encapsulated interface, function
43, with device identification (MEI type 14) in it.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, NamedTuple, Self

from ..checks import integer
from ..errors import ExceptionResponse, IllegalFunction, InvalidResponse
from ..scan import lib
from .request import MAX_PDU, LengthRule, Request, Result, checked_data, in_c, store, unknown_length


@dataclass(frozen=True, slots=True)
class RawRequest(Request[bytes]):
    """
    A request of any function, 1..127, with up to 252 bytes of `data` that are sent unchanged.

    The result is the bytes after the function code of the response, whatever their layout. On RTU
    lines, the response ends where its CRC fits and silence follows.
    """

    function: int  # type: ignore[misc]  # here it is data, not the class's own
    data: bytes = b""

    request_length: ClassVar[LengthRule] = unknown_length
    response_length: ClassVar[LengthRule] = unknown_length

    def __post_init__(self) -> None:
        object.__setattr__(self, "function", integer("function", self.function, 1, 127))
        checked_data("data", self.data, MAX_PDU - 1)

    def encode(self) -> bytes:
        return bytes([self.function]) + self.data

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(pdu[0], pdu[1:])

    def encode_response(self, result: bytes) -> bytes:
        return bytes([self.function]) + checked_data("result", result, MAX_PDU - 1)

    def _decode_response(self, pdu: bytes) -> bytes:
        return pdu[1:]


class MeiType(IntEnum):
    """The interfaces of function 43 (section 6.19)."""

    CANOPEN = 0x0D
    DEVICE_IDENTIFICATION = 0x0E


OBJECT_NAMES = dict(enumerate((
    "VendorName", "ProductCode", "MajorMinorRevision", "VendorUrl", "ProductName", "ModelName",
    "UserApplicationName",
)))  # fmt: skip
"""Object id -> the name that section 6.21 gives it."""


class ReadDeviceIdCode(IntEnum):
    """The objects that are requested (section 6.21)."""

    BASIC = 1
    REGULAR = 2
    EXTENDED = 3
    INDIVIDUAL = 4


# The objects that every device has (section 6.21).
MANDATORY = {0, 1, 2}

# From here on a response may lack an object because there was no room for it.
FULL_MESSAGE = 244

# The last object of each stream.
LAST_OBJECT = dict(zip(ReadDeviceIdCode, (0x02, 0x7F, 0xFF), strict=False))


class IdentificationPage(NamedTuple):
    """
    One response of device identification, which may be one of several.

    Attributes:
        conformity: the level that the device supports: 1 basic, 2 regular, 3 extended; 81h..83h if
            single objects can be read, too.
        next_object: the id of the object to request next; None if there are no more.
        objects: ``{object id: value}``.
        complete: False if the response announces more objects than it contains.
    """

    conformity: int
    next_object: int | None
    objects: dict[int, bytes]
    complete: bool = True


def _request_length(head: bytes) -> int | None:
    if len(head) < 2:
        return None
    return 4 if head[1] == MeiType.DEVICE_IDENTIFICATION else 0


def _response_length(head: bytes) -> int | None:
    if len(head) >= 2 and head[1] != MeiType.DEVICE_IDENTIFICATION:
        return 0
    if len(head) < 7:
        return None
    end = 7
    for _ in range(head[6]):  # objects
        if len(head) < end + 2:
            return None
        end += 2 + head[end + 1]
    return end


class _Encapsulated(Request[Result]):
    """The base of requests of function 43: their lengths, and how devices refuse them."""

    __slots__ = ()
    function: ClassVar[int] = 0x2B

    request_length: ClassVar[LengthRule] = in_c(_request_length, lib.ENCAPSULATED_REQUEST)
    response_length: ClassVar[LengthRule] = in_c(_response_length, lib.ENCAPSULATED_RESPONSE)

    def _refusal(self, pdu: bytes) -> ExceptionResponse | InvalidResponse:
        """Return the error of a refusal: some devices put the MEI type before or after the code."""
        mei_type = self.encode()[1]
        if len(pdu) == 3 and pdu[0] == self.function | 0x80 and mei_type in pdu[1:]:
            return super()._refusal(pdu[:1] + (pdu[2:] if pdu[1] == mei_type else pdu[1:2]))
        return super()._refusal(pdu)


@dataclass(frozen=True, slots=True)
class EncapsulatedTransport(_Encapsulated[bytes]):
    """
    Function 43, section 6.19: send `data` to the interface `mei_type`, 0..255.

    Up to 251 bytes are sent unchanged. MEI type 13 is CANopen (CiA 309-2);
    MEI type 14 is `ReadDeviceIdentification`.
    """

    mei_type: int
    data: bytes

    def __post_init__(self) -> None:
        store(self, mei_type=integer("mei_type", self.mei_type, 0, 0xFF))
        checked_data("data", self.data, MAX_PDU - 2)

    def encode(self) -> bytes:
        return bytes([self.function, self.mei_type]) + self.data

    @classmethod
    def decode(cls, pdu: bytes) -> EncapsulatedTransport | ReadDeviceIdentification:  # type: ignore[override]
        if pdu[1] == MeiType.DEVICE_IDENTIFICATION:
            return ReadDeviceIdentification.decode(pdu)
        if pdu[1] != MeiType.CANOPEN:
            raise IllegalFunction(f"no MEI type {pdu[1]}", function=cls.function)
        return cls(pdu[1], pdu[2:])

    def encode_response(self, result: bytes) -> bytes:
        return bytes([self.function, self.mei_type]) + checked_data("result", result, MAX_PDU - 2)

    def _decode_response(self, pdu: bytes) -> bytes:
        if pdu[:2] != bytes([self.function, self.mei_type]):
            raise self._invalid(f"{pdu[:4].hex(' ')}")
        return pdu[2:]


@dataclass(frozen=True, slots=True)
class ReadDeviceIdentification(_Encapsulated[IdentificationPage]):
    """
    Function 43 with MEI type 14, section 6.21: read one page of the identification.

    `code` is 1..4 (`ReadDeviceIdCode`). `object_id`, 0..255, is the first object for codes 1..3,
    and the only one for code 4.
    """

    code: int
    object_id: int = 0

    repeatable = True
    changes = False
    room: ClassVar[int] = MAX_PDU - 7

    def __post_init__(self) -> None:
        code = integer("code", self.code, 1, 4)
        store(self, code=code, object_id=integer("object_id", self.object_id, 0, 0xFF))

    def encode(self) -> bytes:
        return bytes([self.function, MeiType.DEVICE_IDENTIFICATION, self.code, self.object_id])

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(pdu[2], pdu[3])

    def encode_response(self, result: IdentificationPage) -> bytes:
        conformity, next_object, objects, _ = result
        if not self._answers(objects):
            raise ValueError(f"result must hold object {self.object_id} alone")
        more, following = (0, 0) if next_object is None else (0xFF, next_object)
        head = [self.function, MeiType.DEVICE_IDENTIFICATION, self.code, conformity]
        body = b"".join(bytes([at, len(value)]) + value for at, value in objects.items())
        if len(body) > self.room:
            raise ValueError(f"objects take {len(body)} bytes, more than {self.room}")
        return bytes([*head, more, following, len(objects)]) + body

    def _answers(self, objects: dict[int, bytes]) -> bool:
        """Return True if the objects were requested: any objects of a stream, or the single one."""
        return self.code != ReadDeviceIdCode.INDIVIDUAL or list(objects) == [self.object_id]

    def _decode_misfit(self, pdu: bytes, length: int | None) -> IdentificationPage:
        """Decode a page of a device that announces all objects, but sends only those that fit."""
        if len(pdu) < FULL_MESSAGE or (length is not None and length < len(pdu)):
            Request._decode_misfit(self, pdu, length)  # slots make another class: super() fails
        return self._decode_response(pdu)._replace(complete=False)

    def _decode_response(self, pdu: bytes) -> IdentificationPage:
        if pdu[1] != MeiType.DEVICE_IDENTIFICATION or pdu[2] != self.code:
            raise self._invalid(f"{pdu[:4].hex(' ')}")
        objects: dict[int, bytes] = {}
        at = 7
        while at + 2 <= len(pdu) and (end := at + 2 + pdu[at + 1]) <= len(pdu):
            if pdu[at] in objects:
                raise self._invalid(f"object {pdu[at]} twice")
            objects[pdu[at]] = pdu[at + 2 : end]
            at = end
        if not self._answers(objects):
            raise self._invalid(f"objects {list(objects)}")
        return IdentificationPage(pdu[3], pdu[5] if pdu[4] else None, objects)


class DeviceIdentification(NamedTuple):
    """
    The identification of a device.

    Attributes:
        conformity: the level that the device supports: 1 basic, 2 regular, 3 extended; 81h..83h if
            single objects can be read, too.
        objects: ``{object id: value}``.
        complete: False if the device sent the same objects again, or fewer than it announced; the
            three mandatory objects are there nevertheless.
    """

    conformity: int
    objects: dict[int, bytes]
    complete: bool = True

    @property
    def names(self) -> dict[str, str]:
        """Return ``{name: text}`` of the objects 0..6, with the names of section 6.21."""
        return {
            OBJECT_NAMES[number]: value.decode("ascii", "replace")
            for number, value in self.objects.items()
            if number in OBJECT_NAMES
        }


LEVELS = {code.name.lower(): code for code in LAST_OBJECT}
"""Argument of `read_device_identification` -> the code."""


def identify(
    level: str | int,
) -> Generator[ReadDeviceIdentification, IdentificationPage, DeviceIdentification]:
    """
    Read the identification page by page: a generator that yields requests and is sent pages.

    A wrong page ends it: with what was read, if the mandatory objects are there, else with an
    InvalidResponse.
    """
    if not isinstance(level, str):
        code, first = ReadDeviceIdCode.INDIVIDUAL, integer("level", level, 0, 0xFF)
    elif level in LEVELS:
        code, first = LEVELS[level], 0
    else:
        raise ValueError(f"level must be one of {', '.join(LEVELS)}, or 0..255, not {level!r}")
    request = ReadDeviceIdentification(code, first)
    objects: dict[int, bytes] = {}
    while True:
        page = yield request
        objects.update(page.objects)
        trouble = _trouble(request, page)
        if trouble and not objects.keys() >= MANDATORY:
            raise InvalidResponse(trouble, function=request.function, asked=str(request))
        if trouble or page.next_object is None or request.code == ReadDeviceIdCode.INDIVIDUAL:
            return DeviceIdentification(page.conformity, objects, complete=not trouble)
        request = ReadDeviceIdentification(request.code, page.next_object)


def _trouble(request: ReadDeviceIdentification, page: IdentificationPage) -> str:
    """Return why no further page can be read; empty if one can, or is not needed."""
    following = page.next_object
    if not page.complete:
        return "more objects are promised than came"
    if following is None or request.code == ReadDeviceIdCode.INDIVIDUAL:
        return ""
    if following > max([request.object_id, *page.objects]):
        return ""
    return f"object {following} comes next, though {max(page.objects, default=0)} was there"


def pages(request: ReadDeviceIdentification, objects: Mapping[int, bytes]) -> IdentificationPage:
    """
    Return the answer of a device with these objects, in ascending order; its conformity is 0.

    A request for an object that is not in its stream starts it over (section 6.21).
    """
    last = LAST_OBJECT[ReadDeviceIdCode(request.code)]
    numbers = [number for number in objects if number <= last]
    start = request.object_id if request.object_id in numbers else 0
    page: dict[int, bytes] = {}
    room = request.room
    for number in numbers:
        if number < start:
            continue
        room -= 2 + len(objects[number])
        if room < 0:
            return IdentificationPage(0, number, page)
        page[number] = objects[number]
    return IdentificationPage(0, None, page)
