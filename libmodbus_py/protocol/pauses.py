"""
The silence between the frames of a serial line, in seconds.

Source: MODBUS over Serial Line V1.02, section 2.5.1.1.
"""

from __future__ import annotations

__all__ = ["ALLOWANCE", "pause_between_frames"]

# Start bit, 8 data bits, parity or a second stop bit, stop bit.
CHARACTER_BITS = 11

# Above this rate the silence does not become shorter.
FASTEST, SHORTEST = 19_200, 0.00175

ALLOWANCE = 0.02
"""Seconds after which a byte that was received is here: USB adapters keep bytes for 16 ms."""


def pause_between_frames(baudrate: int, bits: int = CHARACTER_BITS) -> float:
    """
    Return the silence that ends a frame and precedes the next: 3.5 characters, 1.75 ms at least.

    Args:
        baudrate: bits per second, 1 or more.
        bits: of a character; less than 11 count as 11.
    """
    if baudrate > FASTEST:
        return SHORTEST
    return 3.5 * max(bits, CHARACTER_BITS) / baudrate
