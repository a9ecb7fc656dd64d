"""
Asks. What is decided is decided once, and two drivers wait and read for it.

From the caller to the wire:

    requests           every method, once for both clients
    blocking           Context, TcpContext, UdpContext, RtuContext, AsciiContext
    asynchronous       AsyncClient
    options            what both take, and its types
    batch              what one caller asks, and what became of it; Statistics
    conversation       who may send when, who is told what; no socket, no clock
      in_flight        ... whose answer it is, by transaction ids
      in_turn          ... and on lines without them
    reconnecting       when to connect again
    blocking_driver    waits for a conversation by polling; threads, forks, Ctrl-C
    asyncio_driver     waits for it in an event loop, with one reader and one timer
    libmodbus          the short way around the conversation, in one call of C

Beside it: plan (many reads in few requests), trace (what goes over the wire), hints (what
bytes that answer nothing look like).
"""
