"""
Commands that run until a signal ends them.

::

    serve        a device file
    gateway      routes or a gateway file
    poll         a fleet file
    fleet        what the workers do that share a fleet
    limits       the options that say what clients may cost
    metrics      the option for Prometheus
    page         the option for a live page
    addresses    HOST:PORT, as typed
    announcing   where a server listens, and who may come
    hangup       what SIGHUP means: a file to read again, or a terminal that closed
"""
