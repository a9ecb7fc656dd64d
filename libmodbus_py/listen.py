"""
Listening to other devices on a line or in a capture file: a short path to `tools.listener`.
"""

from .tools.listener.capture import CaptureError as CaptureError
from .tools.listener.listener import Listener as Listener
from .tools.listener.listener import listen as listen
from .tools.listener.separator import Separator as Separator
from .tools.listener.transaction import Summary as Summary
from .tools.listener.transaction import Transaction as Transaction

__all__ = ["CaptureError", "Listener", "Separator", "Summary", "Transaction", "listen"]
