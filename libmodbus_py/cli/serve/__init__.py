"""
Commands that run until a signal ends them.

::

    serve        simulated devices
    gateway      requests forwarded to other lines
    poll         a fleet of devices, polled
    fleet_table  ... as lines for a terminal
    fleet        the workers that poll a fleet together
    limits       the options that limit what clients may use
    metrics      the option for metrics, and HOST:PORT on the command line
    page         the option for a live page
    audit        the options for an audit trail
    announcing   messages: where a server listens, who can reach it, and that it serves
    hangup       SIGHUP: a file to read again, or a terminal that was closed
"""
