"""The backend of modbus-connection where that is not installed."""

import importlib
import sys

import pytest

from libmodbus_py.version import how_to_add

NAME = "libmodbus_py.services.integrations.modbus_connection"


def test_import_says_in_one_line_what_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [module for module in sys.modules if module.startswith(NAME)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "modbus_connection", None)
    with pytest.raises(ImportError) as caught:
        importlib.import_module(NAME)
    assert str(caught.value) == (
        "the backend of modbus-connection needs modbus-connection and Python 3.12 or newer: "
        + how_to_add("homeassistant")
    )
