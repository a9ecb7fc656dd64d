"""
Collecting garbage often without looking at all that a run of tests has gathered.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator

__all__ = ["new_garbage_only"]


@contextlib.contextmanager
def new_garbage_only() -> Iterator[None]:
    """Let `gc.collect` look only at what is made meanwhile: 1 ms each time instead of 200."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
