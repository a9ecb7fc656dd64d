"""The short path of `protocol.framing`: importing this module gives that module."""

import sys

from .protocol import framing

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .protocol.framing import *  # noqa: F403

sys.modules[__name__] = framing
