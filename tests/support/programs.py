"""Programs that tests, fuzzers and benchmarks start, also those outside a user's PATH."""

import os
import shutil
import socket
import subprocess
import time
from typing import Any, Self

# Debian installs servers here, and leaves these folders out of the PATH of ordinary users.
SERVER_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


def find(name: str) -> str | None:
    """Return the path of a program, or None if it is not installed."""
    folders = [os.environ.get("PATH", os.defpath), *SERVER_FOLDERS]
    return shutil.which(name, path=os.pathsep.join(folders))


def program(name: str) -> str:
    """Return the path of a program. Raise `FileNotFoundError`: the program is not installed."""
    path = find(name)
    if path is None:
        raise FileNotFoundError(f"{name} is not installed")
    return path


def missing(*names: str) -> list[str]:
    """Return those of these programs that are not installed."""
    return [name for name in names if find(name) is None]


def run_to_end(
    *command: object, seconds: float = 60, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, which must come within so many seconds; collect what it prints."""
    words = [str(word) for word in command]
    return subprocess.run(words, capture_output=True, text=True, timeout=seconds, **options)


class HeldPort:
    """
    A port of 127.0.0.1 that the system gives to nobody else until it is closed. A program that sets
    SO_REUSEADDR may listen there, as servers do, and may end and start again. `number`: of the
    port.
    """

    def __init__(self) -> None:
        self._socket = socket.socket()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind(("127.0.0.1", 0))
        self.number: int = self._socket.getsockname()[1]

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def listens(process: subprocess.Popen[Any], port: int) -> None:
    """
    Wait until a server accepts connections at a port of 127.0.0.1. Raise `AssertionError`: the
    server ended, or does not listen for 20 s.
    """
    for _ in range(2000):
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            return
        except OSError:
            assert process.poll() is None, "the server ended"
            time.sleep(0.01)
    raise AssertionError("the server does not listen")
