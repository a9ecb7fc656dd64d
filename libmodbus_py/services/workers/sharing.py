"""
The assignment of slots to workers. All workers that may hold the same slots get nearly equal
numbers of them, and few slots move. Workers with the same view of the bucket compute the same
assignment.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping

from .records import Slot

__all__ = ["share"]


def share(
    slots: Collection[Slot], holders: Mapping[Slot, str], zones: Mapping[str, Collection[str]]
) -> dict[Slot, str]:
    """
    Return the worker of each slot. Slots that no worker may hold are left out.

    Args:
        slots: the slots with connections.
        holders: slot -> its current holder; holders that `zones` does not contain are ignored.
        zones: worker that may hold slots -> its zones.
    """
    pools: defaultdict[tuple[str, ...], list[Slot]] = defaultdict(list)
    for slot in sorted(slots):
        pools[tuple(sorted(worker for worker in zones if slot.zone in zones[worker]))].append(slot)
    shared: dict[Slot, str] = {}
    for workers, pool in sorted(pools.items()):
        if workers:
            shared.update(_pool(pool, holders, workers))
    return shared


def _pool(
    slots: list[Slot], holders: Mapping[Slot, str], workers: tuple[str, ...]
) -> dict[Slot, str]:
    has: dict[str, list[Slot]] = {worker: [] for worker in workers}
    homeless: list[Slot] = []
    for slot in slots:
        has.get(holders.get(slot, ""), homeless).append(slot)
    least, more = divmod(len(slots), len(workers))
    # The workers with the most slots get the larger quotas, so that fewer slots move.
    by_size = sorted(workers, key=lambda worker: (-len(has[worker]), worker))
    quota = {worker: least + (at < more) for at, worker in enumerate(by_size)}
    for worker, its in has.items():
        homeless += its[quota[worker] :]
        del its[quota[worker] :]
    for worker, its in has.items():
        while len(its) < quota[worker]:
            its.append(homeless.pop())
    return {slot: worker for worker, its in has.items() for slot in its}
