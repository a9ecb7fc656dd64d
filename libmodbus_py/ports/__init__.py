"""
Ports: TCP, TLS, UDP and serial, and how to wait for them.

    endpoint       URLs: which port, which framing, which options
      hosts        ... hosts that are this machine
      schemes      ... that there are
    making         the port of a client, made for its endpoint
    port           what all ports have in common; the silence of a line
    names          host names, looked up in threads
    waiting        steps that yield what they wait for; run by polling
    waiting_async  and by an event loop
    sockets        TCP connections and UDP sockets
    outage         a port or connection that is lost and comes back
    listening      sockets that listen on all addresses of a host
    tls            TLS connections: the handshake, and what it refuses
    trace          every ADU that passes, for callbacks and the log
    serial         serial ports, which libmodbus opens and configures; RS-485, echo, locks
    serial_devices  the serial ports of this machine
    forking        descriptors that forked children close
    read_only      serial ports that are only read, beside other users
"""
