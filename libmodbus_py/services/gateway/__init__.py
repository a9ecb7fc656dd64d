"""
Forwards requests of clients on any endpoints to devices on any lines.

In the order in which a request passes::

    gateway       Gateway: endpoints and lines; routes may change while it runs
    dispatcher    sends each request to its line; the sessions that wait for responses
    config        gateway files in TOML
    routes        Route: the units of a line and the allowed requests; options of all lines
    line          GatewayLine: a shared line, with joined reads and cached responses; its requests
    silent_units  units that do not answer, and when they are tried again
    statistics    counters by line and by unit, also as registers of the gateway itself
    shown_gateway lines, units and clients as the live page shows them
"""
