"""
The short path of `protocol.pdu`: whoever imports this has that very module.
"""

import sys

from .protocol import pdu
from .protocol.pdu import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = pdu
