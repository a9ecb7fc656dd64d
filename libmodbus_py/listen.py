"""Listening to other devices on a line or in a capture file: a short path to `tools.listener`."""

from .tools.listener.listener import Listener, listen
from .tools.listener.named import MapDecoder, NamedValue
from .tools.listener.packets import CaptureError
from .tools.listener.separator import Separator
from .tools.listener.transaction import Summary, Transaction

__all__ = [
    "CaptureError", "Listener", "MapDecoder", "NamedValue", "Separator", "Summary", "Transaction",
    "listen",
]  # fmt: skip
