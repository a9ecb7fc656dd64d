"""URLs of every scheme, made from the table of transports."""

from libmodbus_py.ports.schemes import SCHEMES, TRANSPORTS, TransportRules

CONNECTING = [scheme for scheme, (_, kind) in SCHEMES.items() if not TRANSPORTS[kind].is_listening]
"""The schemes of clients that connect, and of servers."""


def rules_of(scheme: str) -> TransportRules:
    """Return the rules of the transport of a scheme."""
    return TRANSPORTS[SCHEMES[scheme][1]]  # type: ignore[index]


def url_for(
    scheme: str, host: str = "10.0.0.1", line: str = "/dev/line", path: str | None = None
) -> str:
    """
    Return a URL of a scheme. `host`: of networks, with its port if it needs one; `line`: the path
    of serial ports, with its settings; `path`: the path of others that have one; by default that of
    the documentation.
    """
    rules = rules_of(scheme)
    if rules.is_serial:
        return f"{scheme}://{line}"
    return f"{scheme}://{(path or rules.example) if rules.has_path else host}"
