"""The function codes that framers, clients and servers know: `REQUESTS`, and what looks it up."""

from __future__ import annotations

from typing import Any, TypeVar

from ..checks import checked_callback
from ..errors import IllegalDataAddress, IllegalDataValue, IllegalFunction
from . import files, interface, reads, serial, writes
from .request import AddressError, Request, length_by

Kind = TypeVar("Kind", bound=type[Request[Any]])

REQUESTS: dict[int, type[Request[Any]]] = {
    request.function: request
    for request in (
        *(reads.ReadCoils, reads.ReadDiscreteInputs),
        *(reads.ReadHoldingRegisters, reads.ReadInputRegisters),
        *(writes.WriteCoil, writes.WriteRegister, writes.WriteCoils, writes.WriteRegisters),
        *(writes.MaskWriteRegister, writes.ReadWriteRegisters),
        *(serial.ReadExceptionStatus, serial.Diagnostics, serial.ReadCommEventCounter),
        *(serial.ReadCommEventLog, serial.ReportServerId),
        *(files.ReadFileRecords, files.WriteFileRecords, files.ReadFifoQueue),
        interface.EncapsulatedTransport,
    )
}
"""Function code -> request class."""


def register(request: Kind) -> Kind:
    """
    Register a request class of a program with framers, clients and servers; return the class.

    It can be used as a decorator. The class derives from `Request` and has a `function`,
    two length rules (`fixed`, `counted`, `unknown_length`, or a function),
    `encode`, `decode`, `encode_response` and `_decode_response`. RTU framers that are made
    later recognise its frames; the rules `fixed` and `counted` do not slow them down.

    Args:
        request: the class; its function is a user-defined one, 65..72 or 100..110, or another
            one for which there is no class yet.

    Raises:
        TypeError: the argument is no such class, or a length rule is no function, or one defined
            with ``async def``.
        ValueError: the function is not in 1..127, or has a class already.
    """
    if not (isinstance(request, type) and issubclass(request, Request)):
        raise TypeError(f"request must be a class derived from Request, not {request!r}")
    function = getattr(request, "function", 0)
    if function not in range(1, 128):
        raise ValueError(f"{request.__name__}: function must be in 1..127, not {function!r}")
    for name in ("request_length", "response_length"):
        checked_callback((request.__name__, name), getattr(request, name, None))
    other = REQUESTS.get(function)
    if other is not None and other is not request:
        raise ValueError(f"{request.__name__}: function {function} is {other.__name__}")
    REQUESTS[function] = request
    return request


def decode_request(pdu: bytes) -> Request[Any]:
    """
    Decode any request PDU, as a server does.

    Checks everything that needs no device, in the order of the per-function
    diagrams of section 6: function, length, quantities and constants, address
    range.

    Args:
        pdu: 1..253 bytes.

    Raises:
        IllegalFunction: the function is not in `REQUESTS`, or the MEI type is unknown.
        IllegalDataValue: a length, quantity, byte count or constant is wrong.
        IllegalDataAddress: address + quantity is more than 65536, or a file or record cannot
            exist.
        ValueError: `pdu` is empty.
    """
    if not pdu:
        raise ValueError("pdu must hold at least the function code")
    request = REQUESTS.get(pdu[0])
    if request is None:
        raise IllegalFunction(f"no function {pdu[0]}", function=pdu[0])
    try:
        length = length_by(request, request.request_length, pdu)
        if length not in (len(pdu), 0):
            raise ValueError(f"a request of {len(pdu)} bytes")
        return request.decode(pdu)
    except AddressError as error:
        raise IllegalDataAddress(str(error), function=pdu[0]) from None
    except ValueError as error:
        raise IllegalDataValue(str(error), function=pdu[0]) from None


def request_length(head: bytes) -> int | None:
    """
    Return the length of the request PDU that begins with these bytes.

    Args:
        head: one byte or more.

    Returns:
        The length; None if more bytes are needed; 0 if the PDU does not contain its length;
        `NO_LENGTH` if the rule of a registered class raised an exception or returned anything
        else, which is logged once for each class.
    """
    request = REQUESTS.get(head[0])
    return 0 if request is None else length_by(request, request.request_length, head)


def response_length(head: bytes) -> int | None:
    """Return the length of a response PDU, as `request_length`; 2 for exception responses."""
    if head[0] & 0x80:
        return 2
    request = REQUESTS.get(head[0])
    return 0 if request is None else length_by(request, request.response_length, head)
