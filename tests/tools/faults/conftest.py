"""
The stage of the tests of faults.
"""

from __future__ import annotations

from tests.server.conftest import stage

__all__ = ["stage"]
