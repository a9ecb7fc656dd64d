"""
A simulated world: the package's own clients, servers, gateways, fleets and workers on a clock that
jumps and a network in memory, where one seed decides all that happens.

From below: `events` has the clock; `loop` runs asyncio on it; `sockets` and `lines` carry bytes;
`network` has the package use them in place of the system's. `devices` answer, well or badly;
`rules` say what must hold; `plant` casts all of them, and ``python -m tests.simulation`` runs it.
"""
