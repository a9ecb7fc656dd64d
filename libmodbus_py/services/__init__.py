"""
Services: programs that run for months, and connections with other software.

::

    gateway        forwards requests from any endpoint to the devices of any line
    fleet          polls many devices and passes their readings to outputs
    workers        several machines that share the devices of a fleet
    engine         the connection with NATS, which workers use to coordinate
    integrations   metrics for Prometheus; a backend for Home Assistant's modbus-connection
    tasks          the end of tasks that may lose a cancellation
    server_url     URLs of brokers, databases and NATS servers
    loading        files of any kind: maps, devices, gateways, fleets
"""
