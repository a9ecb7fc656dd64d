"""
What carries bytes, and how to wait for it.

    endpoint    URLs: which port, which framing, which options
    port        what all ports have in common; the silence of a line
    waiting     steps that yield what they wait for; run by polling or by an event loop
    sockets     TCP connections and UDP sockets
    tls         TLS connections: the handshake, and what it refuses
    serial      serial ports, which libmodbus opens and configures; RS-485, echo, locks
    read_only   serial ports that are only read, beside whoever talks
"""
