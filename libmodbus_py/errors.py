"""
The short path of `protocol.errors`: importing this module gives that module.
"""

import sys

from .protocol import errors
from .protocol.errors import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = errors
