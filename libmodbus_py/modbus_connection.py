"""
A backend of Home Assistant's modbus-connection: a short path to
`services.integrations.modbus_connection`.
"""

from .services.integrations.modbus_connection import *  # noqa: F403
from .services.integrations.modbus_connection import __all__ as __all__
