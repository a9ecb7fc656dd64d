"""
Services: programs that run for months, and what connects them with others.

::

    gateway        requests passed on from any endpoint to the devices of any line
    fleet          many devices polled, and their readings given to outputs
    workers        several machines that share the devices of a fleet
    engine         the connection with NATS, where workers find each other
    integrations   metrics for Prometheus; a backend for Home Assistant's modbus-connection
    loading        files of any kind: maps, devices, gateways, fleets
"""
