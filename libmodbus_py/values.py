"""The short path of `protocol.values`: importing this module gives that module."""

import sys

from .protocol import values

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .protocol.values import *  # noqa: F403

sys.modules[__name__] = values
