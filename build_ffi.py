"""
Declares the C side: what is called, and the library it is called in.

Out-of-line API mode, so the compiler checks every prototype against the
installed modbus.h and fills in every constant. setup.py compiles both modules:
`pip install -e .` puts them beside the package's own files.
"""

from pathlib import Path

from cffi import FFI

BINDING = Path(__file__).parent / "libmodbus_py" / "binding"
PROTOCOL = BINDING.parent / "protocol"

ffi = FFI()
ffi.cdef((BINDING / "_libmodbus.h").read_text())
ffi.set_source(
    "libmodbus_py.binding._libmodbus",
    "".join((BINDING / name).read_text() for name in ("_libmodbus.c", "answer_chunk.c")),
    libraries=["modbus"],
)

# A module of its own, for the protocol knows no library.
scan = FFI()
scan.cdef((PROTOCOL / "scan.h").read_text())
scan.set_source(
    "libmodbus_py.protocol._scan",
    "#include <stddef.h>\n#include <stdint.h>\n"
    + "".join((PROTOCOL / f"scan.{end}").read_text() for end in "hc"),
)
