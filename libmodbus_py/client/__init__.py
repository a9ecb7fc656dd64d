"""
The clients. One connection makes the decisions, and two drivers wait, read and send for it.

From the caller to the wire:

    procedures         methods of several requests, once for both clients: many, plans, maps
      requests         methods of one request; how methods of both clients are made, and their
                       types for type checkers
      polling          reads at a steady pace, for watch()
    handle             a unit, its timeouts, and the connection that it shares
    blocking           the blocking client, `Client`
    asynchronous       AsyncClient
    options            the options of both, and the parts made of them
    call               one request, its timeouts and its outcome; several requests of a caller
    blocking_driver    waits with poll, for any thread; forks, Ctrl-C
    asyncio_driver     waits in an event loop, with one reader and one timer
    connection         when each request is sent, and its outcome; without sockets or clocks
      queue            which request is next, and how many may be in flight
      outcomes         what becomes of a request: a result, an error with the likely mistake, a
                       repetition
      ids              which answer belongs to which request, by transaction ids
      line             the same on lines, where frames have no ids: a table of states
      answers          earlier answers on a line, with which others are compared
    reconnecting       times of attempts to connect again; State; calls of user functions
    statistics         counters of a connection; Statistics
"""
