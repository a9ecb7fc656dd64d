"""
The base of all requests, and of those that are echoed.
"""

from __future__ import annotations

import reprlib
from typing import Any, ClassVar, Generic, Self, TypeVar

from ..errors import ExceptionResponse, InvalidResponse, in_hex
from .fields import LengthRule

Result = TypeVar("Result")


class Request(Generic[Result]):
    """
    The base of all requests.

    Class attributes:
        function: the function code, 1..127.
        request_length, response_length: length rules of the two PDUs.
        may_be_broadcast: True if unit 0 may stand for all units, because the request changes the
            device and its response contains nothing new.
        repeatable: True if it may be sent again when its response was lost, because executing it
            twice has the same effect as executing it once.
        changes: False if it changes nothing in the device, so that it may be sent beside others.

    Attributes:
        expects_response: True if a server answers it, unless it is a broadcast.

    Constructors raise TypeError or ValueError with the name of the argument and its
    range; ``str()`` of a request describes it in words, for messages.
    """

    __slots__ = ()

    function: ClassVar[int]
    request_length: ClassVar[LengthRule]
    response_length: ClassVar[LengthRule]
    may_be_broadcast: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False
    changes: bool = True
    expects_response: bool = True

    def encode(self) -> bytes:
        """Encode the request PDU."""
        raise NotImplementedError

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        """
        Decode a request PDU of this function, whose length has been checked.

        Raises:
            ValueError: a quantity, byte count or constant is wrong.
        """
        raise NotImplementedError

    def encode_response(self, result: Result) -> bytes:
        """
        Encode the response PDU that a server sends.

        Args:
            result: the result that the client's method for this function returns.

        Raises:
            TypeError, ValueError: the result does not fit the request.
        """
        raise NotImplementedError

    def decode_response(self, pdu: bytes) -> Result:
        """
        Decode the response PDU.

        Returns:
            The result that the client's method for this function returns.

        Raises:
            ExceptionResponse: the server refused the request; the subclass for the code.
            InvalidResponse: the PDU is not a valid response to this request.
        """
        if not pdu or pdu[0] != self.function:
            raise self._refusal(pdu)
        length = type(self).response_length(pdu)
        if length != len(pdu) and length != 0:
            return self._decode_misfit(pdu, length)
        return self._decode_response(pdu)

    def _decode_misfit(self, pdu: bytes, length: int | None) -> Result:
        raise self._invalid(f"a response of {len(pdu)} bytes")

    def _decode_response(self, pdu: bytes) -> Result:
        raise NotImplementedError

    def _refusal(self, pdu: bytes) -> ExceptionResponse | InvalidResponse:
        if len(pdu) == 2 and pdu[0] == self.function | 0x80:
            return ExceptionResponse.of(pdu[1], function=self.function, asked=str(self))
        error = self._invalid(f"response {pdu[:8].hex(' ') or 'without a byte'}")
        error.answers_another = bool(pdu) and pdu[0] & 0x7F != self.function
        return error

    def _invalid(self, what: str) -> InvalidResponse:
        return InvalidResponse(f"answered with {what}", function=self.function, asked=str(self))

    def __str__(self) -> str:
        shown = (f"{name}={reprlib.repr(value)}" for name, value in arguments(self).items())
        return f"{type(self).__name__}({', '.join(shown)})"


def arguments(request: Request[Any]) -> dict[str, Any]:
    """
    Return the arguments of a request by name, as people are shown them: the fields of a dataclass,
    the public attributes of an object of any other class.
    """
    from dataclasses import fields, is_dataclass

    if not is_dataclass(request):
        given = getattr(request, "__dict__", {})
        return {name: value for name, value in given.items() if name[0] != "_"}
    names = [field.name for field in fields(request) if field.repr]
    return {name: getattr(request, name) for name in names if hasattr(request, name)}


class Echoed(Request[None]):
    """A write whose response repeats the first bytes of the request."""

    __slots__ = ()
    may_be_broadcast = True
    repeatable = True
    echoed: ClassVar[int]

    def encode_response(self, result: None = None) -> bytes:
        return self.encode()[: self.echoed]

    def _decode_response(self, pdu: bytes) -> None:
        if pdu != self.encode_response():
            raise self._invalid(f"the echo {in_hex(pdu)}")
