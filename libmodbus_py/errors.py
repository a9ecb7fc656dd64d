"""The short path of `protocol.errors`: importing this module gives that module."""

import sys

from .protocol import errors

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .protocol.errors import *  # noqa: F403

sys.modules[__name__] = errors
