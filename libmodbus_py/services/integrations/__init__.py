"""
Integrations with other software; each needs the extra that is named in brackets.

::

    modbus_connection   a backend of Home Assistant's modbus-connection: libmodbus-py[homeassistant]
    prometheus          statistics as metrics of Prometheus: libmodbus-py[metrics]
    exposition          serves these metrics over HTTP: libmodbus-py[metrics]
"""
