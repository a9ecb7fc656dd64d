"""
Tests that want the machine for themselves, because they tell what happens within seconds: while
one of them runs, no other test does, in whatever process of whatever run of this clone.

Each test holds a lock; these hold it alone. A gate before it lets none wait for ever.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Generator
from pathlib import Path

import pytest

__all__ = ["pytest_configure", "pytest_runtest_protocol"]


FOLDER = Path(__file__).parents[2] / ".pytest_cache" / "locks"


def _lock_file(name: str) -> int:
    """Open a lock file where pytest keeps its own: in the clone, not in the folder /tmp."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    return os.open(FOLDER / name, os.O_RDWR | os.O_CREAT, 0o600)


# Locks of POSIX belong to this process: what tests fork or start does not keep them.
GATE, LOCK = _lock_file("gate"), _lock_file("tests")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "alone: no other test runs meanwhile")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Outermost, so that waiting takes nothing of the test's time."""
    kind = fcntl.LOCK_EX if item.get_closest_marker("alone") else fcntl.LOCK_SH
    fcntl.lockf(GATE, fcntl.LOCK_EX)
    fcntl.lockf(LOCK, kind)
    fcntl.lockf(GATE, fcntl.LOCK_UN)
    try:
        return (yield)
    finally:
        fcntl.lockf(LOCK, fcntl.LOCK_UN)
