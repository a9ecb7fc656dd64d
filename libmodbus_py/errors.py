"""
The short path of `protocol.errors`: whoever imports this has that very module.
"""

import sys

from .protocol import errors
from .protocol.errors import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = errors
