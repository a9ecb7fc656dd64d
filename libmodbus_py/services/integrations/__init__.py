"""
Integrations with other software; each file needs an extra, named in brackets.

::

    modbus_connection   a backend of Home Assistant's modbus-connection: libmodbus-py[homeassistant]
    prometheus          the statistics of clients and servers as metrics: libmodbus-py[metrics]
    exposition          ... over HTTP, for programs without a web server
"""
