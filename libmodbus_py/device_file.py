"""
The short path of `simulator.device_file`: importing this module gives that module.
"""

import sys

from .tools.simulator import device_file
from .tools.simulator.device_file import *  # noqa: F403 (for type checkers)

sys.modules[__name__] = device_file
