"""
The short path of `protocol.values`: importing this module gives that module.
"""

import sys

from .protocol import values
from .protocol.values import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = values
