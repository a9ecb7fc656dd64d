"""
Programs that PyInstaller freezes.

::

    hook-libmodbus_py   names the modules that are imported when they are first used
"""

from __future__ import annotations

__all__ = ["hook_folders"]


def hook_folders() -> list[str]:
    """Return where PyInstaller finds the hook: its entry point ``pyinstaller40``."""
    return list(__path__)
