"""
Integrations with other software; each needs the extra that is named in brackets.

::

    modbus_connection   a backend of Home Assistant's modbus-connection: libmodbus-py[homeassistant]
    prometheus          statistics as metrics of Prometheus, and their server: libmodbus-py[metrics]
"""
