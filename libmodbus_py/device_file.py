"""The short path of `tools.simulator.device_file`: importing this module gives that module."""

import sys

from .tools.simulator import device_file

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .tools.simulator.device_file import *  # noqa: F403

sys.modules[__name__] = device_file
