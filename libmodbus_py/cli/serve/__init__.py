"""
Commands that run until a signal ends them.

::

    serve        simulated devices
    gateway      requests forwarded to other lines
    poll         a fleet of devices, polled
    fleet        the workers that poll a fleet together
    clients      what clients may do, and who did it: options for limits and for an audit trail
    over_http    the options for metrics and for a live page, and HOST:PORT on the command line
    running      messages: where a server listens, and that it serves; SIGHUP
"""
