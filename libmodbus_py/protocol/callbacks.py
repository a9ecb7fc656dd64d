"""
Functions that users pass to the package: what is logged when one of them fails.
"""

from __future__ import annotations

import contextlib
import sys

__all__ = ["log_failure"]


def log_failure(logger: str, text: str, *args: object) -> None:
    """
    Log the exception that is being handled; one that a log handler raises goes to stderr.

    Args:
        logger: the name of the logger.
        text, args: as for `logging.Logger.exception`.
    """
    import logging  # no sooner than needed: most programs log no failure

    try:
        logging.getLogger(logger).exception(text, *args)
    except Exception:
        import traceback

        with contextlib.suppress(Exception):  # stderr may be closed
            traceback.print_exc(file=sys.stderr)
