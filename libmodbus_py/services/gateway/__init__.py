"""
Passes requests on: clients on any endpoints of the server, devices behind any lines of clients.

In the order in which a request goes through::

    gateway       Gateway: endpoints and lines, routes that change
    dispatcher    sends each request to its line; the sessions that wait for responses
    config        gateway files: all of it in TOML
    options       GatewayOptions: how requests wait, whatever line they go to
    routes        Route: units, lines, what may be done; parsed and checked
    loops         lines that lead back to the gateway, or nowhere
    raw_request   RequestBytes: a request as bytes, and what is known of it
    own_device    the gateway as a device: its statistics as registers
    line          GatewayLine: one AsyncClient, and the requests that wait for it
    silent_units  units that gave no answer, and when they are tried again
    cache         what was read before
    statistics    what happened, by line and by unit
"""
