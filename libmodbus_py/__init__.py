"""
Modbus for Python on Debian's libmodbus.

Its folders, floor by floor. Imports run downwards only, and folders on the same floor do not
import each other::

    cli                 libmodbus-py: read, write, scan, listen, serve, gateway, poll, demo
    services            gateway, fleet, workers, engine, integrations
    tools               files, listener, scan, simulator, testing, page, certificates
    client   server     TcpContext, ..., AsyncClient send requests; Server answers them
    ports    device     transports, and waiting for them; one unit and its tables
    maps                register maps: named points, and plans that read them with few requests
    binding  security   the C library; Modbus Security: certificates and roles
    protocol            bytes and values: PDUs, frames, errors; no socket, no clock
    late                public names imported when they are first used
    system              calls that only Linux has, and their substitutes elsewhere
    version             the version number

The public names of the package are those of ``__init__.pyi``; each is imported when it is first
used. The other files are public modules that take their names from the folders: ``errors``,
``framing``, ``low_level``, ``pdu`` and ``values``; ``listen``, ``scan``, ``page`` and ``serve``;
``fleet``, ``device_file``, ``bound`` and ``sunspec``; ``testing``; ``prometheus`` and
``modbus_connection``.

A read goes ``client`` -> ``protocol.pdu`` -> ``protocol.framing`` -> ``ports`` -> the wire ->
``ports`` -> ``server`` -> ``device`` -> libmodbus's modbus_reply on the tables, and back. The
docstring of each folder names its files.

Addresses are 0-based and times are in seconds everywhere.
"""

from .late import Public, moved
from .version import __version__ as __version__

# Where modules were before, and programs may still look for them.
_MOVED = {
    "engine": "services.engine",
    "fleet": "services.fleet",
    "gateway": "services.gateway",
    "integrations": "services.integrations",
    "listener": "tools.listener",
    "listener.listening": "tools.listener.listener",
    "page": "tools.page",
    "scan": "tools.scan",
    "scan.scanning": "tools.scan.scan",
    "scan.searching": "tools.scan.search",
    "security.making": "tools.certificates",
    "server.delivery": "tools.faults.delivery",
    "simulator": "tools.simulator",
    "testing": "tools.testing",
    "toml": "tools.files",
    "workers": "services.workers",
}

moved(__name__, _MOVED)

_PUBLIC = Public(__name__, __file__)
__all__ = _PUBLIC.names
__getattr__ = _PUBLIC.named


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
