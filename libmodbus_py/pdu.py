"""
The short path of `protocol.pdu`: importing this module gives that module.
"""

import sys

from .protocol import pdu
from .protocol.pdu import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = pdu
