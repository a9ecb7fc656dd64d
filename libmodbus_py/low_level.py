"""
The short path of `binding.low_level`: importing this module gives that module.
"""

import sys

from .binding import low_level
from .binding.low_level import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = low_level
