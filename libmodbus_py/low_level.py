"""
The short path of `binding.low_level`: importing this module gives that module.
"""

import sys

from .binding import low_level

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .binding.low_level import *  # noqa: F403

sys.modules[__name__] = low_level
