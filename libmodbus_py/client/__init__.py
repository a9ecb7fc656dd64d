"""
Asks. What is decided is decided once, and two drivers wait and read for it.

From the caller to the wire:

    requests           every method, once for both clients
    handle             a unit, its timeouts, and the connection that it shares
    blocking           Context, TcpContext, UdpContext, RtuContext, AsciiContext
    asynchronous       AsyncClient
    options            what both take, and the parts made of it
    batch              what one caller asks, and what became of it
    timeouts           how long a caller waits
    blocking_driver    waits by polling, for any thread; forks, Ctrl-C
    asyncio_driver     waits in an event loop, with one reader and one timer
    shortcut           the short way, when nothing needs deciding
      libmodbus        ... in one call of C
    turns              who may ask when; no socket, no clock, as all that follows
    conversation       who is told what
      in_flight        ... whose answer it is, by transaction ids
      in_turn          ... and on lines without them
      hints            what bytes that answer nothing look like
    reconnecting       when to connect again; State
    statistics         what happened, counted; Statistics
"""
