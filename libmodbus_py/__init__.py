"""
Modbus for Python on Debian's libmodbus: clients and servers, over networks and serial lines.

::

    from libmodbus_py import Client, IllegalDataAddress

    with Client("tcp://192.0.2.10", unit=17, timeout=1.0) as plc:
        plc.write_registers(100, [555, 0, 100])
        plc.read_holding_registers(100, 3)             # [555, 0, 100]
        plc.read_values("input_registers", 0, "float32", 2)   # [21.5, 1013.25]
        try:
            plc.read_coils(60000, 10)
        except IllegalDataAddress as error:
            print(error)                               # names unit, function, request and reason

Addresses are 0-based and times are in seconds everywhere. The names that most programs need:

====================== ==========================================================================
Client                 a client for any URL, such as "tcp://192.0.2.10" or "rtu:///dev/ttyUSB0"
AsyncClient            the same for asyncio, with the same methods as coroutines
TcpContext             libmodbus itself: each method is one call of C; also RtuContext
Server                 answers requests over any number of transports
Device                 one unit of a server: its tables, its files, and what may be done with them
Mapping                the tables of a device: coils, discrete inputs, holding and input registers
load_map               loads a `RegisterMap`, which gives registers names, types and scales
ExceptionResponse      the server refused a request; its subclasses tell why
ModbusError            the base of all errors: also ModbusTimeoutError and ModbusConnectionError
====================== ==========================================================================

Modules with more public names:

====================== ==========================================================================
pdu, framing, values   bytes only: requests and responses, frames, and values in registers
errors                 the exceptions
serve, device_file     hooks, rules and audits of servers; devices that files describe
bound, sunspec         register maps bound to clients; SunSpec models of inverters and meters
fleet                  polling of many devices, with a journal and outputs
scan, listen           searching for units and registers; listening to other devices
page                   a live page of a running server
prometheus             metrics
modbus_connection      a backend for Home Assistant's modbus-connection
testing                serial lines, recording servers and faults for tests
low_level              libmodbus itself
====================== ==========================================================================
"""

from .late import Public
from .version import __version__ as __version__

# The public names are those of __init__.pyi; each is imported when it is first used.
_PUBLIC = Public(__name__, __file__)
__all__ = _PUBLIC.names


def __getattr__(name: str) -> object:
    try:
        return _PUBLIC.named(name)
    except AttributeError as error:
        from .protocol.other_names import unknown_name

        raise unknown_name(error, name) from None


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_PUBLIC.modules})
