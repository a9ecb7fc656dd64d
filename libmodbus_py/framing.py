"""
The short path of `protocol.framing`: importing this module gives that module.
"""

import sys

from .protocol import framing
from .protocol.framing import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = framing
