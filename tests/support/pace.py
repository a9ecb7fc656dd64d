"""
How much later than promised a test lets things happen: what runs it does other things, too.

No test says how fast something is; `./run bench` does. The end of a wait is told here from an end
that would come many seconds later, or never.
"""

from __future__ import annotations

__all__ = ["LATE"]

# Seconds. Busy machines were seen to hold a process for one.
LATE = 4.0
