"""
libmodbus itself: ``lib`` contains its functions and constants, ``ffi`` creates their arguments.

Everything in modbus.h, modbus-tcp.h and modbus-rtu.h is available under its C name.
The classes of this package avoid the following traps; this module does not. They were
measured on Debian's 3.1.6 and on 3.1.12:

* A function that returns -1 has set ``ffi.errno``; no exception is raised. libmodbus
  never clears errno, and some failures do not set it.
* An RTU context without ``modbus_set_slave`` aborts the process on the first
  read or write. Descriptors of 1024 and above abort it in every receive.
* Calling ``modbus_free`` twice aborts the process, and a freed context contains garbage.
  ``modbus_free`` does not close the connection, and a second ``modbus_connect`` leaks the old
  descriptor.
* Counts and addresses are not checked: an address of 65536 is sent as 0, and a
  buffer that is too short is read or written past its end.
* A context is not thread-safe, and every call here releases the GIL: use one lock
  for each context.
* After a late response, every further response on TCP is refused, and on RTU the
  late one is taken for the next. ``modbus_flush`` on RTU drops output, too.
* ``MODBUS_ERROR_RECOVERY_LINK`` never returns while the peer is away, and not
  on Ctrl-C either.
* ``modbus_reply`` reads past the end of short requests, sleeps for a response timeout after
  an illegal quantity or function, and then drops what the client has sent meanwhile.
* ``modbus_receive`` ignores the length field on TCP, so that the body of an unknown function
  is taken for the next request.
* ``modbus_set_float_*`` and ``modbus_get_float_*`` disagree between versions: use struct.
* ``modbus_enable_quirks``, ``modbus_disable_quirks``, ``modbus_send_raw_request_tid`` and
  ``modbus_proxy`` return -1 with ENOSYS if the loaded library is too old to have them.
"""

from __future__ import annotations

from .binding.library import ffi, lib, loaded_version

__all__ = ["ffi", "lib", "loaded_version"]
