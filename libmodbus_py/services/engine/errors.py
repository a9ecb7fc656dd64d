"""
The errors of NATS, each explained in one line.
"""

from __future__ import annotations

import contextlib
import os
import ssl
from collections.abc import Iterator

from ...security.describing import in_words

__all__ = ["EngineError", "EngineGone", "NothingThere", "explained", "what"]

# The errors of JetStream by number: temporary ones, while there is no leader or servers are not up,
# and lasting ones.
TRANSIENT = {
    10005: "too few servers are up to store three copies",
    10008: "JetStream has no leader now; are most of the servers up?",
    10009: "",
    10023: "JetStream has too little room or too few servers",
}
LASTING = {
    10039: "JetStream is off for this account",
    10047: "JetStream has no room left on its disk",
    10076: "JetStream is off; nats-server needs -js",
}


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

    try:
        yield
    except EngineError:
        raise
    except (nats.errors.Error, OSError) as error:
        raise _kind(error)(f"{where}: {what(error)}") from None


def _kind(error: Exception) -> type[EngineError]:
    import nats.errors
    import nats.js.errors as js

    if isinstance(error, js.BucketNotFoundError):
        return NothingThere
    is_lasting = isinstance(error, js.APIError) and error.err_code not in TRANSIENT
    if is_lasting or isinstance(error, js.NoStreamResponseError | nats.errors.NoRespondersError):
        return EngineError
    return EngineGone


def what(error: BaseException) -> str:
    """Return the explanation of an exception of nats-py."""
    import nats.errors as basic
    import nats.js.errors as js

    match error:
        case js.BucketNotFoundError():
            return "there is no fleet yet; put it there with --push"
        case js.APIError(err_code=code, description=text):
            known = TRANSIENT.get(code or 0) or LASTING.get(code or 0)
            return known or text or "JetStream is off or not ready"
        case js.NoStreamResponseError() | basic.NoRespondersError():
            return "JetStream is off, or the stream was deleted; nats-server needs -js"
        case ssl.SSLCertVerificationError():
            return f"the certificate is not trusted: {in_words(error)}; see NATS_CA"
        case ssl.SSLError():
            return f"TLS failed: {in_words(error)}"
        case TimeoutError():
            return "no answer; are most of the servers up?"
        case ConnectionError(args=()):
            return "the connection was lost"
        case (
            basic.NoServersError()
            | basic.OutboundBufferLimitError()
            | basic.ConnectionClosedError()
            | basic.ConnectionReconnectingError()
            | basic.StaleConnectionError()
        ):
            return "no server responds"
        case OSError(errno=int(number)) if number:
            # asyncio puts the address in place of the reason.
            return os.strerror(number) if number > 0 else str(error.strerror)
    if "authorization violation" in str(error).lower():
        return "the server refuses the credentials; see NATS_USER, NATS_PASSWORD, NATS_CREDS"
    return str(error).removeprefix("nats: ").strip("'\" ") or type(error).__name__
