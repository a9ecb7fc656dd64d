"""
libmodbus itself: ``lib`` has its functions and constants, ``ffi`` makes their arguments.

Everything in modbus.h, modbus-tcp.h and modbus-rtu.h is here under its C name.
The classes of this package keep you out of the traps below; here nothing does.
Measured on Debian's 3.1.6 and on 3.1.12:

* A function that returns -1 has set ``ffi.errno``; nothing is raised. libmodbus
  never clears it, and some failures set nothing.
* An RTU context without ``modbus_set_slave`` aborts the process on the first
  read or write. Descriptors of 1024 and above abort it in every receive.
* ``modbus_free`` twice aborts, after use it reads garbage; ``modbus_free`` does not
  close, and ``modbus_connect`` again leaks the old descriptor.
* Counts and addresses are not checked: an address of 65536 is sent as 0, and a
  buffer that is too short is read or written past its end.
* A context is not thread-safe, and every call here gives up the GIL: one lock
  for each context.
* After a late answer every further answer on TCP is refused, and on RTU the
  late one is taken for the next. ``modbus_flush`` on RTU drops output, too.
* ``MODBUS_ERROR_RECOVERY_LINK`` never returns while the peer is away, and not
  on Ctrl-C either.
* ``modbus_reply`` reads past short requests, sleeps for a response timeout after
  an illegal quantity or function, and then throws away what the client sent.
* ``modbus_receive`` ignores the length field on TCP, so functions it does not know
  leave their body in the stream as the next request.
* ``modbus_set_float_*`` and ``modbus_get_float_*`` disagree between versions: use struct.
* ``modbus_enable_quirks``, ``modbus_disable_quirks``, ``modbus_send_raw_request_tid`` and
  ``modbus_proxy`` give -1 with ENOSYS where the loaded library is too old to have them.
"""

from __future__ import annotations

from .library import ffi, lib, loaded_version

__all__ = ["ffi", "lib", "loaded_version"]
