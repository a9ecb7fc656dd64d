"""
Register maps bound to clients: a short path to `maps.bound_map`.
"""

from .maps.bound_map import BoundMap as BoundMap
from .maps.bound_map import MapBinding as MapBinding

__all__ = ["BoundMap", "MapBinding"]
