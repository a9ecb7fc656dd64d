"""What tests of clients over TLS share."""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from .tls_peers import TlsServer

LONG = 20.0  # a timeout in seconds that no good answer needs, on a machine that is busy

SOON = 10.0  # what comes at once takes no longer, in seconds, on a machine that is busy

Serving = Callable[..., TlsServer]
"""Makes a server of a script, an identity, a version and options of `context_of`."""

Talking = Callable[..., AbstractContextManager[tuple[TlsServer, Any]]]
"""Makes a server as `Serving` does, and a client that is connected to it."""


def descriptors() -> int:
    """Return how many descriptors this process has."""
    return len(os.listdir("/proc/self/fd"))
