"""
Hosts: with their ports as text, those that are this machine, look-ups of names, and sockets that
listen on their addresses.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import threading
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from ..system import call_in_children

LOCALHOST = ("localhost", "ip6-localhost")

# Hosts at which a server listens on all addresses of its machine.
EVERYWHERE = ("0.0.0.0", "::")

# A family and an address as getaddrinfo returns it -> a socket bound to it.
Make = Callable[[socket.AddressFamily, tuple[Any, ...]], socket.socket]

# Names that Python's codec of international names refuses with a message of each release.
NO_NAME = "it cannot be the name of a host"

# Connections that may wait in the system.
BACKLOG = 4096

# An address of a family that this machine does not have, such as ::1 without IPv6.
NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)

# The second form is an IPv6 address without brackets, which no port can follow.
HOST_AND_PORT = re.compile(
    r"\[(?P<address>[^\[\]\s]+)\](?::(?P<a>[0-9]{1,5}))?"
    r"|(?P<bare>[^/\[\]@\s]*:[^/\[\]@\s]*:[^/\[\]@\s]*)"
    r"|(?P<name>[^:/\[\]@\s]+)(?::(?P<b>[0-9]{1,5}))?"
)


def host_and_port(host: str, port: int) -> str:
    """Return a host and its port as text, such as "192.0.2.1:502" or "[::1]:502"."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def split_host_and_port(text: str) -> tuple[str, int | None]:
    """Return the host and the port, if any, of text such as "192.0.2.1:502", "[::1]" or "::1"."""
    match = HOST_AND_PORT.fullmatch(text)
    if match is None:
        raise ValueError(f"must be HOST or HOST:PORT, not {text!r}")
    port = match["a"] or match["b"]
    if port is not None and int(port) > 65535:
        raise ValueError(f"the port must be in 0..65535, not {port}")
    return match["address"] or match["bare"] or match["name"], None if port is None else int(port)


def own_address(name: str, text: object) -> tuple[socket.AddressFamily, tuple[str, int]]:
    """Return an address to connect from, with port 0 for any; raise an error that names `name`."""
    if not isinstance(text, str):
        raise TypeError(f"{name} must be a string, not {type(text).__name__}")
    host, port = split_host_and_port(text)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.inet_pton(family, host.partition("%")[0])
    except OSError:
        form = "an address of this machine, such as 192.0.2.5 or 192.0.2.5:40000"
        raise ValueError(f"{name} must be {form}, not {text!r}") from None
    return family, (host, port or 0)


def host_of_peer(peer: str) -> str:
    """Return the host in the name of a server's client; of a path, all but the process."""
    if peer.startswith("/"):
        return re.sub(" pid [0-9]+$", "", peer)
    return peer.rpartition(":")[0].strip("[]")


@lru_cache(1024)
def is_loopback(host: str) -> bool:
    """Return True if only this machine reaches a host; names but localhost are not looked up."""
    host = host.lower().partition("%")[0]
    if host in LOCALHOST:
        return True
    if host.startswith("127."):  # also in the short forms that the system takes, such as 127.1
        return host.replace(".", "").isdigit()
    from ipaddress import IPv6Address, ip_address

    try:
        address = ip_address(host)
    except ValueError:
        return False
    ipv4 = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return (ipv4 or address).is_loopback


def is_this_machine(host: str) -> bool:
    """Return True for loopback, `EVERYWHERE` and the addresses of the interfaces."""
    if host in EVERYWHERE or is_loopback(host):
        return True
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.inet_pton(family, host)
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0))
    except OSError:
        return False
    return True


# A look-up of a name ends only when the system gives up, after many seconds. So each name has a
# thread, which all that ask for the name share: no name waits for another, and no event loop, whose
# own threads would be busy for others, waits for one at its end.


class Resolve(NamedTuple):
    """Look up a name; gives the result of getaddrinfo, or raises its OSError or TimeoutError."""

    host: str
    port: int
    kind: socket.SocketKind
    deadline: float
    flags: int = 0


class Question:
    """A name that is looked up in a thread, for all that ask for it meanwhile."""

    def __init__(self, lookup: Resolve) -> None:
        self.notes: list[Callable[[], object]] = []  # called in that thread at the end
        self._lookup = lookup
        self._outcome: list[Any] | Exception = []
        start_thread(threading.Thread(target=self._look_up, name="look-up", daemon=True))

    def _look_up(self) -> None:
        host, port, kind, _, flags = self._lookup
        try:
            self._outcome = socket.getaddrinfo(host, port, type=kind, flags=flags)
        except UnicodeError:
            self._outcome = socket.gaierror(socket.EAI_NONAME, NO_NAME)
        except Exception as error:  # any exception must end the waits
            self._outcome = error
        with _lock:
            _asked.pop(self._lookup, None)
        for note in self.notes:
            with contextlib.suppress(Exception):  # a loop that was closed meanwhile
                note()

    def result(self) -> list[Any]:
        outcome = self._outcome
        if isinstance(outcome, OSError):
            # A new one for each caller, because a traceback belongs to one.
            raise type(outcome)(*outcome.args) from outcome
        if isinstance(outcome, Exception):
            raise OSError(None, str(outcome)) from outcome
        return outcome


def ask(lookup: Resolve, note: Callable[[], object]) -> Question:
    """Look up a name, or share a look-up; `note` is called in its thread, and must not block."""
    key = lookup._replace(deadline=0.0)
    with _lock:
        question = _asked.get(key) or Question(key)
        _asked[key] = question
        question.notes.append(note)
    return question


def numeric(lookup: Resolve) -> list[Any]:
    """Return the result for a numeric address, which needs no look-up and no thread; else []."""
    flags = lookup.flags | socket.AI_NUMERICHOST
    try:
        # As bytes, because for text Python would import its codec for international names.
        return socket.getaddrinfo(lookup.host.encode(), lookup.port, type=lookup.kind, flags=flags)
    except OSError as error:
        if error.errno is None and error.strerror is None:
            raise  # of a signal handler
        return []
    except UnicodeError:
        return []


def start_thread(thread: threading.Thread) -> None:
    """Start a thread; raise OSError if the system has none left."""
    try:
        thread.start()
    except RuntimeError as error:
        raise OSError(errno.EAGAIN, str(error)) from error


def _begin() -> None:
    """Reset after a fork, too: the threads are the parent's, and one may have held the lock."""
    global _lock, _asked
    # Reentrant, because a signal handler may ask while its own thread does.
    _lock = threading.RLock()
    _asked = {}


_lock: threading.RLock
_asked: dict[Resolve, Question]
_begin()
call_in_children(_begin)


def bind_all(addresses: list[Any], port: int, make: Make) -> list[socket.socket]:
    """Return a socket for each address of this machine that getaddrinfo found, or none at all."""
    sockets: list[socket.socket] = []
    missing: OSError | None = None
    with contextlib.ExitStack() as stack:
        for family, address in dict.fromkeys((row[0], row[4]) for row in addresses):
            try:
                sockets.append(stack.enter_context(make(family, address)))
            except OSError as error:
                if error.errno not in NOT_HERE:
                    raise
                missing = error
            else:
                if not port:  # a free port of this address may be in use on the next
                    break
        if missing is not None and not sockets:
            raise missing
        stack.pop_all()
    return sockets


def tcp_listener(family: socket.AddressFamily, address: tuple[Any, ...]) -> socket.socket:
    """Return a socket that listens on an address; errors have the system's text alone."""
    try:
        return socket.create_server(address, family=family, backlog=BACKLOG)
    except OSError as error:
        raise OSError(error.errno, reason(error)) from error


def listen_on(host: str, port: int) -> list[socket.socket]:
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except UnicodeError as error:
        raise socket.gaierror(socket.EAI_NONAME, NO_NAME) from error
    return bind_all(addresses, port, tcp_listener)


def reason(error: OSError | UnicodeError) -> str:
    """Return the system's text for an error; numbers of getaddrinfo are negative."""
    if isinstance(error, UnicodeError):
        return NO_NAME
    number = error.errno or 0
    return os.strerror(number) if number > 0 else str(error.strerror or error)
