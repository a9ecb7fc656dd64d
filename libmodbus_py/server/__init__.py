"""
Answers clients: bytes in, bytes out, on any number of endpoints in one asyncio loop.

In the order in which a request goes through::

    serving      Serving: opens endpoints, and serves in a loop, in a thread, or for ever, with
                 callbacks for every ADU
    server       Server: devices at any number of endpoints; faults: mistakes in their answers
    state_file   the file that keeps the values of devices over a restart
    running      a server in a thread of its own; signals and garbage of programs that only serve
    peers        TcpServer: takes TCP connections; Peers: all of them within their limits; limits
                 chooses which of them are paused or closed
    udp          answers datagrams; serial answers at a port
    peer         Peer: one connection; Turns: all of them in one poller
    tls          TlsSession: a session within TLS, and the role of the client
    audit        Audit: who wrote what, and who was refused
    service      the interface between endpoints and what answers
    sessions     ByFrame: asks devices frame by frame; ByChunk: Modbus/TCP by the chunk, in C,
                 and single requests of many peers together
    framed       the base of sessions: finds frames, without their own echo
    units        finds the device of a frame, on TCP and on serial lines
"""
