"""Register maps bound to clients, and the items that devices refuse: a short path to `maps`."""

from .maps.refusals import UnreadableItem
from .maps.register_map import BoundMap, MapBinding

__all__ = ["BoundMap", "MapBinding", "UnreadableItem"]
