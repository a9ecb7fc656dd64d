"""
A process that has imported the command line, and forks a process for each command.

A command starts within milliseconds this way: no interpreter starts, and no module is read.
`tests.support.commands` starts this process and asks it. A request is one message: the arguments
and the surroundings as JSON, and the descriptors 0 to 2. The answer is the process id of the
command, which becomes a child of the process that asked.
"""

import atexit
import gc
import importlib
import json
import os
import pkgutil
import signal
import socket
import sys
import threading
from typing import Any, NoReturn

LONGEST_REQUEST = 200_000


# Folders that no command of the tests needs, and that import large packages.
LEFT_OUT = ("integrations", "testing", "__main__")


def import_everything() -> None:
    """Import all modules that commands use, if their dependencies are installed."""
    import libmodbus_py

    for module in pkgutil.walk_packages(libmodbus_py.__path__, "libmodbus_py."):
        if module.name.split(".")[1] not in LEFT_OUT:
            try:
                importlib.import_module(module.name)
            except ImportError:
                continue  # an extra is not installed


def serve(requests: socket.socket) -> dict[str, Any] | None:
    """
    Fork a process for each request. Return the request, in the process that is to run it; None at
    the end of the requests.
    """
    while True:
        data, descriptors, _, _ = socket.recv_fds(requests, LONGEST_REQUEST, 3)
        if not data:
            return None
        between = os.fork()
        if between == 0:
            return _second_fork(requests, json.loads(data), descriptors)
        for descriptor in descriptors:
            os.close(descriptor)
        os.waitpid(between, 0)
        requests.send(b"adopted")


def _second_fork(
    requests: socket.socket, request: dict[str, Any], descriptors: list[int]
) -> dict[str, Any]:
    """Leave the command without a parent, which makes it a child of the process that asked."""
    if child := os.fork():
        requests.send(str(child).encode())
        os._exit(0)
    requests.close()
    for number, descriptor in enumerate(descriptors):
        os.dup2(descriptor, number)
        os.close(descriptor)
    return request


def become(request: dict[str, Any]) -> None:
    """Take the surroundings that a program has when a shell starts it."""
    if request["new_session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["libmodbus-py", *request["arguments"]]
    at_once = "PYTHONUNBUFFERED" in os.environ
    sys.stdin = sys.__stdin__ = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = sys.__stdout__ = _output(1, at_once or os.isatty(1))
    sys.stderr = sys.__stderr__ = _output(2, True)


def _output(descriptor: int, at_once: bool) -> Any:
    return open(
        descriptor,
        "w",
        encoding="utf-8",
        errors="strict" if descriptor == 1 else "backslashreplace",
        buffering=1 if at_once else -1,
        closefd=False,
    )


def end(code: int) -> NoReturn:
    """
    End as an interpreter does, but for the memory.

    To free each object copies the pages that are shared with the other commands: 0.1 s.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def main() -> None:
    requests = socket.socket(fileno=int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the tests
    import_everything()
    gc.freeze()
    request = serve(requests)
    if request is None:
        return
    from libmodbus_py.cli.main import main as command_line

    become(request)
    try:
        code = command_line()
    except SystemExit as ended:
        code = int(ended.code or 0)
    end(code)


if __name__ == "__main__":
    main()
