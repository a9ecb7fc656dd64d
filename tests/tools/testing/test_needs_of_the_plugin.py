"""
The version of pytest that the plugin needs: declared by the package, and checked by the plugin.
"""

from __future__ import annotations

import runpy
import tomllib
from pathlib import Path

import pytest

from libmodbus_py.tools.testing import plugin


def test_the_package_declares_it() -> None:
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    assert project["optional-dependencies"]["pytest"] == ["pytest>=7"]


def test_the_plugin_refuses_an_older_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(pytest, "StashKey")  # which pytest 7 brought
    monkeypatch.setattr(pytest, "__version__", "6.2.5")
    with pytest.raises(pytest.UsageError, match=r"need pytest 7 or newer, not 6\.2\.5"):
        runpy.run_path(plugin.__file__, run_name="libmodbus_py.tools.testing.plugin")
