"""
Answers clients: bytes in, bytes out, on any number of endpoints in one asyncio loop.

In the order in which a request goes through::

    server       Server: endpoints from URLs, in a loop, in a thread, or for ever
    background   the thread
    listening    makes their sockets; forked children close them (forking)
    tcp          takes connections and hands them to `peers`; udp answers datagrams,
                 serial a port
    peers        Peers: TCP connections within their limits (limits), all in one epoll;
                 addresses and idle say who of them has had enough
    tls          TlsSession: what a connection says within TLS, and the role of who asks
    sources      whose datagrams are answered
    by_chunk     ByChunk: Modbus/TCP by the chunk, in C; requests of many peers together
    by_frame     ByFrame: any framing, frame by frame
    units        which device answers a frame, on TCP and on serial lines
    faults       what goes wrong with an answer, where a simulation wants it
"""
