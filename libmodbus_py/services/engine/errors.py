"""
The errors of NATS, each explained in one line.
"""

from __future__ import annotations

import contextlib
import os
import ssl
from collections.abc import Iterator
from typing import Any

from ...security.describing import in_words

__all__ = ["EngineError", "EngineGone", "NothingThere", "explained", "what"]

# Codes of temporary JetStream errors: no leader is elected, or servers are not up yet.
NO_PEERS, NO_LEADER, NOT_LEADER, NO_ROOM = 10005, 10008, 10009, 10023
TRANSIENT = (NO_PEERS, NO_LEADER, NOT_LEADER, NO_ROOM)


class EngineError(Exception):
    """NATS cannot be used. The message begins with the URL or the name of the bucket."""


class NothingThere(EngineError):
    """The bucket does not exist."""


class EngineGone(EngineError):
    """NATS does not respond now, but may do so later."""


@contextlib.contextmanager
def explained(where: str) -> Iterator[None]:
    """
    Raise an `EngineError` in place of the exceptions of nats-py.

    Args:
        where: the beginning of the message: a URL or the name of a bucket.
    """
    import nats.errors
    import nats.js.errors as js

    try:
        yield
    except EngineError:
        raise
    except js.BucketNotFoundError:
        raise NothingThere(f"{where}: there is no fleet yet; put it there with --push") from None
    except js.APIError as error:
        kind = EngineGone if error.err_code in TRANSIENT else EngineError
        raise kind(f"{where}: {_of_jetstream(error)}") from None
    except (js.NoStreamResponseError, nats.errors.NoRespondersError):
        raise EngineError(
            f"{where}: JetStream is off, or the stream was deleted; nats-server needs -js"
        ) from None
    except (nats.errors.TimeoutError, TimeoutError):
        raise EngineGone(f"{where}: no answer; are most of the servers up?") from None
    except (nats.errors.Error, OSError) as error:
        raise EngineGone(f"{where}: {what(error)}") from None


def _away(errors: Any) -> tuple[type[Exception], ...]:
    return (
        errors.NoServersError,
        errors.OutboundBufferLimitError,
        errors.ConnectionClosedError,
        errors.ConnectionReconnectingError,
        errors.StaleConnectionError,
    )


def what(error: BaseException) -> str:
    """Return the explanation of an exception of nats-py."""
    import nats.errors

    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate is not trusted: {in_words(error)}; see NATS_CA"
    if isinstance(error, ssl.SSLError):
        return f"TLS failed: {in_words(error)}"
    if isinstance(error, TimeoutError):
        return "no answer"
    if isinstance(error, ConnectionError) and not error.args:
        return "the connection was lost"
    if isinstance(error, _away(nats.errors)):
        return "no server responds"
    if "authorization violation" in str(error).lower():
        return "the server refuses the credentials; see NATS_USER, NATS_PASSWORD, NATS_CREDS"
    if isinstance(error, OSError) and error.errno:
        # asyncio puts the address in place of the reason.
        return os.strerror(error.errno) if error.errno > 0 else str(error.strerror)
    return str(error).removeprefix("nats: ").strip("'\" ") or type(error).__name__


# By the numbers of JetStream's errors.
_NUMBERS = {
    NO_PEERS: "too few servers are up to store three copies",
    NO_LEADER: "JetStream has no leader now; are most of the servers up?",
    NO_ROOM: "JetStream has too little room or too few servers",
    10039: "JetStream is off for this account",
    10047: "JetStream has no room left on its disk",
    10076: "JetStream is off; nats-server needs -js",
}


def _of_jetstream(error: object) -> str:
    number = getattr(error, "err_code", None)
    text = getattr(error, "description", None) or "JetStream is off or not ready"
    return _NUMBERS.get(number or 0, text)
