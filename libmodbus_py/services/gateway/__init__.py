"""
Forwards requests of clients on any endpoints to devices on any lines.

In the order in which a request passes::

    gateway       Gateway: endpoints and lines; routes may change while it runs
    dispatcher    sends each request to its line; the sessions that wait for responses
    config        gateway files in TOML
    options       GatewayOptions: options that hold for all lines
    routes        Route: the units of a line and the allowed requests; parsed and checked
    loops         refuses lines that lead back to the gateway, or to no serial port
    raw_request   RequestBytes: a request as bytes, with its decoded form
    own_device    the gateway as a device: its statistics as registers
    line          GatewayLine: one AsyncClient, and the requests that wait for it
    silent_units  units that do not answer, and when they are tried again
    cache         responses to earlier reads
    statistics    counters by line and by unit
    shown_gateway lines, units and clients as the live page shows them
"""
