"""
Integrations with other software; each needs the extra that is named in brackets.

::

    metrics             names, types and texts of metrics, and how they are read
    modbus_connection   a backend of Home Assistant's modbus-connection: libmodbus-py[homeassistant]
    prometheus          a registry with the metrics, and their server: libmodbus-py[metrics]
"""
