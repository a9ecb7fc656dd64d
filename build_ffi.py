"""
Declares the C side: what is called, and the library it is called in.

Out-of-line API mode, so the compiler checks every prototype against the
installed modbus.h and fills in every constant.
"""

from pathlib import Path

from cffi import FFI

HERE = Path(__file__).parent / "libmodbus_py" / "binding"

ffi = FFI()
ffi.cdef((HERE / "_libmodbus.h").read_text())
ffi.set_source(
    "libmodbus_py.binding._libmodbus",
    "".join((HERE / name).read_text() for name in ("_libmodbus.c", "answer_chunk.c")),
    libraries=["modbus"],
)

if __name__ == "__main__":
    ffi.compile(verbose=True)
