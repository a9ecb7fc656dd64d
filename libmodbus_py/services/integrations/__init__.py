"""
What other programs want to know, in their own form; each file needs an extra of its own.

::

    modbus_connection   a backend of Home Assistant's modbus-connection: libmodbus-py[homeassistant]
    prometheus          the statistics of clients and servers as metrics: libmodbus-py[metrics]
    exposition          ... over HTTP, for programs that have no web server
"""
