"""
Answers clients: bytes in, bytes out, on any number of endpoints in one asyncio loop.

In the order in which a request goes through::

    server       Server: devices, served
    serving      what serves: endpoints from URLs, in a loop, in a thread, or for ever
    background   the thread
    garbage      no search for garbage in what does not change
    signals      handlers in the loop; afterwards the previous ones are restored
    echo         EchoWatch: finds out whether a port returns what is sent
    without_echo  the same for the connections of a TCP endpoint
    listening    makes their sockets; forked children close them
    tcp          takes connections and hands them to `peers`; udp answers datagrams (datagrams:
                 from the address that was asked), serial a port
    peers        Peers: TCP connections within their limits (limits), all in one poller;
                 addresses and idle choose which of them are paused or closed
    tls          TlsSession: what a connection says within TLS, and the role of who asks
    audit        Audit: who wrote what, and who was refused
    sources      whose datagrams are answered
    tracing      who is told of every ADU that sessions receive and send
    service      the seam: what an endpoint knows of what answers; devices is one of them
    by_chunk     ByChunk: Modbus/TCP by the chunk, in C; requests of many peers together
    framed       what sessions have in common that answer frame by frame; ByFrame (by_frame)
                 asks devices, also for what C leaves
    units        which device answers a frame, on TCP and on serial lines
    faults       Fault: what goes wrong with an answer, where a simulation wants it
"""
