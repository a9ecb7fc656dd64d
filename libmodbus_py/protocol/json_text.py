"""
The encoders of JSON.

All values that the package tells in JSON pass through one of these. They raise a ValueError for a
nan or an infinity, in place of which `plain.plain` returns None.
"""

from __future__ import annotations

import json

__all__ = ["ASCII_JSON", "COMPACT_JSON", "JSON", "SORTED_JSON", "json_text"]

JSON = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
"""Encodes text as it is."""

ASCII_JSON = json.JSONEncoder(allow_nan=False)
"""Encodes text in ASCII."""

COMPACT_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
"""Encodes text in ASCII, without spaces."""

SORTED_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), sort_keys=True)
"""Encodes the same for equal values, without spaces."""

json_text = ASCII_JSON.encode
