"""
Whose request is next: clients take turns. No socket, no clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Hashable, Iterator
from typing import Generic, Protocol, TypeVar

__all__ = ["Turns", "Waiting"]


class Waiting(Protocol):
    """A request that waits."""

    @property
    def host(self) -> Hashable:
        """Whose client asks: all of one host share its turns."""
        ...

    @property
    def client(self) -> Hashable: ...

    @property
    def unit(self) -> int:
        """Who is asked, as the line has it."""
        ...


Each = TypeVar("Each", bound=Waiting)

# Who comes next is first; who had a turn goes to the end.
Queues = dict[Hashable, deque[Each]]


class Turns(Generic[Each]):
    """
    The requests that wait for a line: hosts take turns, within each its clients, and the
    requests of each client are in their order.

    Args:
        most_of_client: how many of one client may wait.
        most: how many in all.
    """

    def __init__(self, most_of_client: int, most: int) -> None:
        self._most_of_client = most_of_client
        self._most = most
        self._hosts: dict[Hashable, Queues[Each]] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Each]:
        return (
            each for queues in self._hosts.values() for queue in queues.values() for each in queue
        )

    def put(self, each: Each) -> bool:
        """Have it wait, unless too many do."""
        if self._count >= self._most:
            return False
        queues = self._hosts.get(each.host)
        if queues is None:
            queues = self._hosts[each.host] = {}
        queue = queues.get(each.client)
        if queue is None:
            queue = queues[each.client] = deque()
        elif len(queue) >= self._most_of_client:
            return False
        queue.append(each)
        self._count += 1
        return True

    def take(self, held: Collection[int] = ()) -> Each | None:
        """Give the next one, but none for units that are held."""
        if not self._count:
            return None
        if not held:
            host = next(iter(self._hosts))
            client = next(iter(self._hosts[host]))
            each = self._hosts[host][client][0]
        else:
            found = next((each for each in self if each.unit not in held), None)
            if found is None:
                return None
            each = found
        self.remove(each)
        self._end_turn(each)
        return each

    def remove(self, each: Each) -> None:
        """It does not wait any more."""
        queues = self._hosts[each.host]
        queue = queues[each.client]
        if queue[0] is each:
            queue.popleft()
        else:
            queue.remove(each)
        self._count -= 1
        if not queue:
            del queues[each.client]
            if not queues:
                del self._hosts[each.host]

    def has(self, each: Each) -> bool:
        return each in self._hosts.get(each.host, {}).get(each.client, ())

    def of_unit(self, unit: int) -> list[Each]:
        return [each for each in self if each.unit == unit]

    def _end_turn(self, each: Each) -> None:
        queues = self._hosts.get(each.host)
        if queues is None:
            return
        if each.client in queues:
            queues[each.client] = queues.pop(each.client)
        self._hosts[each.host] = self._hosts.pop(each.host)
