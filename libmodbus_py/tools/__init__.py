"""
Tools on top of clients and servers, for people who look at what happens.

::

    files          what stands in files: TOML and CSV, and register maps in either
    faults         servers with faults in their answers
    listener       transactions of other devices on a line
    scan           units that answer, the settings of their line, and the registers that they have
    sunspec        SunSpec models of a device, as register maps
    simulator      devices from a file, whose values move and whose answers fail
    testing        for tests: lines with a tap, servers that record, the pytest plugin
    page           a live page of a server, in a browser
    timed_server   a TCP server whose connections have a limited time: pages, taps, metrics
    certificates   an authority and certificates to try Modbus Security with
    authority      the folder of an authority: certificates are renewed, listed and revoked
"""
