"""
Hooks in a file of Python: the functions ``before_write(access)``, ``after_write(access)`` and
``before_read(access)`` are those of `Device`, for each device that is served.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from functools import partial
from traceback import extract_tb
from types import ModuleType
from typing import Any

from ...device.device import Device
from ...device.hooks import Hook, HookLike
from ...files.texts import FileError, FilePlace, reread
from ...protocol.checks import checked_callback
from ...protocol.mistakes import close_to
from ...system import open_file

NAMES = ("before_write", "after_write", "before_read")

# The name of the module that a file becomes.
MODULE = "libmodbus_py_hooks"


class HooksFile:
    """The hooks of a file, which `use` gives to devices, now and after each `read_again`."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._hooks = load_hooks(path)

    def use(self, devices: Device | Mapping[int, Device]) -> None:
        for device in [devices] if isinstance(devices, Device) else devices.values():
            device.change_hooks(**self._hooks)

    def read_again(self, devices: Device | Mapping[int, Device]) -> str:
        """Read the file again; return a line about it. After a mistake, the former hooks stay."""

        def use(hooks: dict[str, HookLike]) -> str:
            self._hooks = hooks
            self.use(devices)
            return f"{self._path}: read again, {', '.join(hooks)}"

        return reread(partial(load_hooks, self._path), use)


def load_hooks(path: str) -> dict[str, HookLike]:
    """Return the hooks of a file by name; a FileError names the file and the line."""
    try:
        with open_file(path) as file:
            source = file.read()
    except OSError as error:
        raise FileError((), f"cannot read {path}: {error.strerror}") from error
    module, before = ModuleType(MODULE), sys.modules.get(MODULE)
    module.__file__ = path
    sys.modules[MODULE] = module  # dataclasses look for it
    try:
        exec(compile(source, path, "exec", dont_inherit=True), vars(module))
        return _checked(vars(module), path)
    except (Exception, SystemExit) as error:
        if before is not None:
            sys.modules[MODULE] = before
        if isinstance(error, FileError):
            raise
        text = error.msg if isinstance(error, SyntaxError) else str(error)
        reason = f"{type(error).__name__}: {text}".replace("\n", " ")
        raise FileError((), reason, place=FilePlace(path, _line(error, path))) from error


def _checked(names: dict[str, Any], path: str) -> dict[str, HookLike]:
    for name, function in names.items():
        if name.startswith(("before_", "after_")) and name not in NAMES:
            reason = f"is no hook; hooks are {', '.join(NAMES)}{close_to(name, NAMES)}"
            raise FileError(name, reason, place=_place(path, function))
    hooks = {name: names[name] for name in NAMES if name in names}
    if not hooks:
        raise FileError((), f"has none of {', '.join(NAMES)}", place=FilePlace(path))
    for name, hook in hooks.items():
        call = hook.call if isinstance(hook, Hook) else hook
        try:
            checked_callback(name, call)
            inspect.signature(call).bind(None)
        except TypeError as error:
            reason = getattr(error, "reason", "must take one argument, an Access")
            raise FileError(name, reason, place=_place(path, call)) from None
        except ValueError:  # a function of C without a signature
            pass
    return hooks


def _place(path: str, function: Any) -> FilePlace:
    line = getattr(getattr(function, "__code__", None), "co_firstlineno", None)
    return FilePlace(path, line)


def _line(error: BaseException, path: str) -> int | None:
    if isinstance(error, SyntaxError) and error.filename == path:
        return error.lineno
    lines = [trace.lineno for trace in extract_tb(error.__traceback__) if trace.filename == path]
    return lines[-1] if lines else None
