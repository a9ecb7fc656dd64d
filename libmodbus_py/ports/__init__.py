"""
Ports: TCP, TLS, UDP, Unix sockets and serial, and how to wait for them.

    endpoint        URLs of endpoints: transport, framing and options
    options         the table of options: what clients take, and URLs and the command line
    schemes         the tables of schemes and transports, with the options of each
    port            the base class of ports, makes them; outages; what forked children close
    hosts           hosts: as text, looked up in threads, and sockets that listen on them
    waiting         steps that yield what they wait for; the ways to run them: blocking, in a loop
    sockets         TCP connections and UDP sockets
    listening       TCP connections that the device makes, and what it sends besides frames
    tls             TLS connections: the handshake, and what it refuses
    unix            Unix sockets, for clients and servers
    trace           every ADU that passes, for callbacks and the log
    serial          serial ports, which libmodbus opens and configures; RS-485, locks; ports that
                    are only read, beside other users
    direction       the direction of RS-485 transceivers: RTS, a GPIO line, a function
    serial_devices  the serial ports of this machine, and the programs that use them
"""
