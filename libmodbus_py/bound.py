"""
Register maps bound to clients, and the items that devices refuse: a short path to `maps`.
"""

from .maps.holes import Unreadable as Unreadable
from .maps.register_map import BoundMap as BoundMap
from .maps.register_map import MapBinding as MapBinding

__all__ = ["BoundMap", "MapBinding", "Unreadable"]
