"""
Commands that run until a signal ends them.

::

    serve        simulated devices
    gateway      requests forwarded to other lines
    poll         a fleet of devices, polled
    fleet        the workers that poll a fleet together
    over_http    the options for metrics and for a live page, and HOST:PORT on the command line
    running      what surrounds a server: limits, audit trail, log, readiness, SIGHUP
"""
