"""
The clients. Decisions are made once, and two drivers wait and read for them.

From the caller to the wire:

    requests           every method, once for both clients
      typed_values     ... the types of values, for type checkers
      procedures       what methods of several requests yield
      plan_reading     ... and how a plan is carried out
      polling          ... and how it is at a steady pace
    handle             a unit, its timeouts, and the connection that it shares
    blocking           Context, TcpContext, UdpContext, RtuContext, AsciiContext
    asynchronous       AsyncClient
    options            the options of both, and the parts made of them
    batch              the requests of one caller, and their outcomes
    timeouts           timeouts and retries of a request
    blocking_driver    waits by polling, for any thread; forks, Ctrl-C
    asyncio_driver     waits in an event loop, with one reader and one timer
      alarm            one timer, for clients, gateways and fleets
    shortcut           the short way of blocking clients, when nothing needs deciding
      libmodbus        ... in one call of C
    lone_request       the short way of asyncio clients
    plain_answers      answers that may come on both short ways
    conversation       which request may be sent when, and its outcome; no socket, no clock
      capacity         ... how many at once: found out
      matching         ... which answer belongs to which request:
      in_flight        ... by transaction ids
      in_turn          ... and on lines without them
      local_echo       ... requests there that come back
      suspicion        ... answers there that may be those to earlier requests
      hints            likely causes of bytes that are no answer
    waiting_room       order of requests on a line of a gateway or a fleet
    notices            calls of user functions that wait until a change is complete
    reconnecting       times of attempts to connect again; State
    statistics         what happened, counted; Statistics
"""
