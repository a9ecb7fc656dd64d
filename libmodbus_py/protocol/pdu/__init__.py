"""
The function codes: one frozen dataclass for each, for clients and servers.

A client encodes a request object and decodes the response with it; a server decodes a request
object and encodes the response with it. PDUs have no unit and no framing, and there is no I/O
here.

Every request class has its function code and two length rules, which tell
the length of a request or response PDU once its first bytes are known. RTU framers
need them, because RTU frames have no end marks. A new function code needs one class
and one row in `REQUESTS`; programs add their own with `register`.

Its files:

    reads           functions 1-4
    writes          5, 6, 15, 16, 22 and 23
    serial          7, 8, 11, 12 and 17
    files           20, 21 and 24: file records and queues
    interface       43, and requests of any function, sent as they are
    function_codes  the table REQUESTS, and the functions that look up requests in it
    request         the base class of all requests; checks and encoding of the fields of a message

The public names are those of ``__init__.pyi``. Each is imported when it is first used, because a
client that reads registers needs two of the files.

Layouts, limits and the order of checks: MODBUS Application Protocol V1.1b3,
section 6. Addresses are 0-based.
"""

from ...late import Public

_PUBLIC = Public(__name__, __file__)
__all__ = _PUBLIC.names
__getattr__ = _PUBLIC.named


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
