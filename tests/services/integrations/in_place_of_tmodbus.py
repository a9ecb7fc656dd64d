"""A plugin of pytest for modbus-connection's own tests: its tmodbus backend is ours."""

from __future__ import annotations

import sys

import modbus_connection

from libmodbus_py.services.integrations import modbus_connection as ours

# Its former name; and what tests of pymodbus's backend replace, too.
ours.TmodbusConnection = ours.ModbusConnection  # type: ignore[attr-defined]
ours._RESPONSE_RETRIES = None  # type: ignore[attr-defined]

sys.modules["modbus_connection.tmodbus"] = ours
modbus_connection.tmodbus = ours  # type: ignore[attr-defined]
