"""
The clients. One conversation makes the decisions, and two drivers wait and read for it.

From the caller to the wire:

    requests           every method, once for both clients
      typed_values     the types of values, for type checkers
      procedures       what methods of several requests yield
      plan_reading     carries out a plan
      polling          reads at a steady pace, for watch()
    handle             a unit, its timeouts, and the connection that it shares
    blocking           Context, TcpContext, UdpContext, RtuContext, AsciiContext
    asynchronous       AsyncClient
    options            the options of both, and the parts made of them
    batch              the requests of one caller, and their outcomes
    timeouts           timeouts and retries of a request
    blocking_driver    waits with poll, for any thread; forks, Ctrl-C
    asyncio_driver     waits in an event loop, with one reader and one timer
      alarm            one timer, for clients, gateways and fleets
    shortcut           sends a single request without the conversation, for blocking clients
    lone_request       sends a single request without the conversation, for asyncio clients
    plain_answers      recognises the answers to such requests
    conversation       which request may be sent when, and its outcome; without sockets or clocks
      capacity         finds out how many requests a device takes at once
      matching         which answer belongs to which request
      in_flight        matching by transaction ids
      in_turn          matching on lines, where frames have no ids
      local_echo       detects that a line returns all requests
      suspicion        recognises answers on lines that may belong to earlier requests
      hints            likely causes of bytes that are not an answer
    waiting_room       order of requests on a line of a gateway or a fleet
    notices            calls of user functions that wait until a change is complete
    reconnecting       times of attempts to connect again; State
    statistics         counters of a connection; Statistics
"""
