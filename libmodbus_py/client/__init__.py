"""
The clients. One connection makes the decisions, and two drivers wait, read and send for it.

From the caller to the wire:

    values_async       typed values, and register maps
      many_async       many requests together, plans of few, and reads at a steady pace
      functions_async  connect, execute, and the methods of one request
    values_blocking    the same of blocking clients, which packaging/generate_blocking.py makes;
                       so are many_blocking and functions_blocking
    handle             a unit, its timeouts, and the connection that it shares
    keywords           wrong keyword arguments of methods, answered with the right one
    blocking           the blocking client, `Client`
    asynchronous       AsyncClient
    sender             sends without a task for each request, for gateways and fleets
    options            the options that only clients know, and the check of all
    call               one request, its timeouts and its outcome; several requests of a caller
    blocking_driver    waits with poll, for any thread; forks, Ctrl-C
    asyncio_driver     waits in an event loop, with one reader and one timer
    task_caller        a task of an event loop that waits for its requests
    connection         when each request is sent, and its outcome; without sockets or clocks
      queue            which request is next, and how many may be in flight
      outcomes         what becomes of a request: a result, an error with the likely mistake, a
                       repetition
      ids              which answer belongs to which request, by transaction ids
      line             the same on lines, where frames have no ids: a table of states
      history          what is known of each line, for the life of the process
    reconnecting       times of attempts to connect again; State; calls of user functions
    statistics         counters of a connection; Statistics
"""
