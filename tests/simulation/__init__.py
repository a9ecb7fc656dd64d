"""
A simulated world: the package's own clients, servers, gateways, fleets and workers on a clock that
jumps and a network in memory, where one seed decides all that happens.

From below: `events` has the clock; `loop` runs asyncio on it, and `processes` stops parts of it;
`sockets` and `lines` carry bytes, and `ports` are the package's own on them; `network` has the
package use all this in place of the system's. `engine` is a NATS server in memory, and
`engine_client` has its clients. `devices` answer, well or badly, and `scripted` peers as a test
says; `rules` say what must hold, and read what is sent; `world`, `scenarios`, `reports` and
`fleets` say who takes part, `runs` runs a scenario, `broken` takes out a rule, and
``python -m tests.simulation`` does it for a while.
"""
