"""
Ports: TCP, TLS, UDP, Unix sockets and serial, and how to wait for them.

    endpoint        URLs of endpoints: transport, framing and options
    options         the table of options: what clients take, and URLs and the command line
    schemes         the tables of schemes and transports
    making          the port of a transport, such as one of sockets, tls and serial
    port            the base class of ports, their outages, and what forked children close
    hosts           hosts: as text, looked up in threads, and sockets that listen on them
    waiting         steps that yield what they wait for; the blocking way to run them
    waiting_async   the way to run steps in an event loop
    sockets         TCP connections and UDP sockets
    listening       TCP connections that the device makes
    greeting        what such a device sends besides frames
    tls             TLS connections: the handshake, and what it refuses
    unix            Unix sockets, for clients and servers
    trace           every ADU that passes, for callbacks and the log
    serial          serial ports, which libmodbus opens and configures; RS-485, echo, locks
    serial_read_only    serial ports that are only read, beside other users
    serial_settings     baud rates without a constant, and whether a driver has made the settings
    direction       the direction of RS-485 transceivers: RTS, a GPIO line, a function
    serial_devices  the serial ports of this machine, and the programs that use them
"""
