"""
Register maps bound to clients: a short path to `maps.register_map`.
"""

from .maps.register_map import BoundMap as BoundMap
from .maps.register_map import MapBinding as MapBinding

__all__ = ["BoundMap", "MapBinding"]
