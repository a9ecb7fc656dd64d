"""
What the meaning of points costs: the time to decode 1000 points, as ratios to points without one.

Run it with the package to measure on the path:

    PYTHONPATH=. python bench/decoding.py
"""

from __future__ import annotations

import time
from typing import Any

from libmodbus_py import Point, RegisterMap

TABLE = "holding_registers"
COUNT = 1000

# Times that each map is decoded; the shortest counts.
ROUNDS = 100

EVERYTHING: dict[str, Any] = {
    "type": "int16", "missing": "sunspec", "plausible_minimum": -1e6, "plausible_maximum": 1e6,
    "never_falls": True, "scale_from": "exponent",
}  # fmt: skip

KINDS: dict[str, dict[str, Any]] = {
    "int16": {"type": "int16"},
    "int16, scaled": {"type": "int16", "scale": 0.1},
    "int16 with everything": EVERYTHING,
    "uint16 with states": {"states": {1234: "on"}, "missing": 7},
    "uint16 with named bits": {"bits": {0: "door", 3: "alarm"}, "missing": 7},
    "bit of a register": {"bit": 3},
    "float32": {"type": "float32"},
    "float32 with bounds": {"type": "float32", "plausible_minimum": -1e30},
}


def seconds(keys: dict[str, Any]) -> float:
    """Return the time to decode the answers of a map whose points all have these keys."""
    size = 2 if keys.get("type") == "float32" else 1
    points = [Point(f"p{at}", TABLE, size * at, **keys) for at in range(COUNT)]
    if "scale_from" in keys:
        points.append(Point(keys["scale_from"], TABLE, size * COUNT, type="int16"))
    plan = RegisterMap(points).plan()
    answers = [[1] * request.count for request in plan.requests]
    shortest = float("inf")
    for _ in range(ROUNDS):
        began = time.perf_counter()
        plan.results(answers)
        shortest = min(shortest, time.perf_counter() - began)
    return shortest


def main() -> None:
    plain = seconds(KINDS["int16"])
    for name, keys in KINDS.items():
        took = seconds(keys)
        print(f"{name:24} {1e6 * took / COUNT:6.2f} us a point {took / plain:6.2f}")


if __name__ == "__main__":
    main()
