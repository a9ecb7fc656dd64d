"""The short path of `protocol.pdu`: importing this module gives that module."""

import sys

from .protocol import pdu

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .protocol.pdu import *  # noqa: F403

sys.modules[__name__] = pdu
