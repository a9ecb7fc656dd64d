"""
Commands that run until a signal ends them.

::

    serve        simulated devices
    gateway      requests forwarded to other lines
    poll         a fleet of devices, polled
    fleet_table  ... as lines for a terminal
    fleet        the workers that poll a fleet together
    limits       the options that limit what clients may use
    metrics      the option for metrics
    page         the option for a live page
    state        the option for a file that keeps values
    audit        the options for an audit trail
    addresses    HOST:PORT on the command line
    announcing   messages: where a server listens, and who can reach it
    readiness    a message to systemd: the command serves
    hangup       SIGHUP: a file to read again, or a terminal that was closed
"""
