"""
The short path of `protocol.values`: whoever imports this has that very module.
"""

import sys

from .protocol import values
from .protocol.values import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = values
