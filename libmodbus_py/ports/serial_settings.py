"""
Settings of serial ports that neither libmodbus nor Python's termios makes or checks.

Linux reports no error if a driver cannot make a setting: `tcsetattr` returns 0, and the port has
another one, usually that of before. So all settings are read back. Which rates a port has is not
known without trying them: only of a plain UART the highest one is.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import termios
from typing import Any

# struct termios2, TCGETS2, TCSETS2, CBAUD and BOTHER of asm-generic/termbits.h; where they differ,
# the ioctl fails.
TERMIOS2 = struct.Struct("4IB19B2I")
TCGETS2, TCSETS2 = 0x802C542A, 0x402C542B
CBAUD, BOTHER = 0o010017, 0o010000

# Numbers of pseudo-terminals (Unix98 slaves of Linux's devices.txt), which have one character size,
# no parity and no line on which it would matter.
PSEUDO_TERMINALS = range(136, 144)

DATA_BITS = {termios.CS5: 5, termios.CS6: 6, termios.CS7: 7, termios.CS8: 8}


def set_odd_baudrate(descriptor: int, baudrate: int) -> None:
    """
    Set a rate without a constant of its own; the port may do another one.

    Raises:
        OSError: the port, or the processor's Linux, takes no such rates.
    """
    try:
        fields = list(TERMIOS2.unpack(fcntl.ioctl(descriptor, TCGETS2, bytes(TERMIOS2.size))))
        fields[2] = fields[2] & ~(CBAUD | CBAUD << 16) | BOTHER
        fields[-2:] = baudrate, baudrate
        fcntl.ioctl(descriptor, TCSETS2, TERMIOS2.pack(*fields))
    except OSError as error:
        raise OSError(error.errno, f"baudrate {baudrate} refused: {error.strerror}") from None


def _baudrate_of(descriptor: int) -> int | None:
    """Return the baud rate of a port as its driver has it; None if Linux does not tell it."""
    try:
        data = fcntl.ioctl(descriptor, TCGETS2, bytes(TERMIOS2.size))
    except OSError:
        return None
    return int(TERMIOS2.unpack(data)[-1])


def check_settings(descriptor: int, device: str, wanted: dict[str, Any]) -> None:
    """
    Raise an OSError for a setting that an open port did not take.

    Args:
        wanted: the settings named in `SERIAL_DEFAULTS`.
    """
    control = termios.tcgetattr(descriptor)[2]
    odd_or_even = "O" if control & termios.PARODD else "E"
    actual = {
        "parity": odd_or_even if control & termios.PARENB else "N",
        "data_bits": DATA_BITS[control & termios.CSIZE],
        "stop_bits": 2 if control & termios.CSTOPB else 1,
    }
    if os.major(os.fstat(descriptor).st_rdev) not in PSEUDO_TERMINALS:
        for name, value in actual.items():
            if value != wanted[name]:
                reason = f"{name} {wanted[name]} refused: the port has {value}"
                raise OSError(errno.EINVAL, reason)
    rate = _baudrate_of(descriptor) or wanted["baudrate"]
    # A receiver tolerates 2 % (serial line, 2.4).
    if abs(rate - wanted["baudrate"]) > wanted["baudrate"] * 0.02:
        from .serial_devices import highest_rate  # which clients do not need otherwise

        highest = highest_rate(device)
        limit = f", and at most {highest}" if highest else ""
        reason = f"baudrate {wanted['baudrate']} refused: the port does {rate}{limit}"
        raise OSError(errno.EINVAL, reason)
