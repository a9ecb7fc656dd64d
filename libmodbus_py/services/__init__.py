"""
Services: programs that run for months, and integrations with other software.

::

    gateway        forwards requests from any endpoint to the devices of any line
    fleet          polls many devices and passes their readings to outputs
    workers        several machines that share the devices of a fleet
    engine         the connection to NATS, through which workers coordinate
    integrations   metrics for Prometheus; a backend for Home Assistant's modbus-connection
    line           one connection that is shared: which request is sent next, and when
    tasks          cancels tasks, and waits for their end
    other_servers  URLs of brokers, databases and NATS servers, and credentials in files
    loading        loads files of any kind: maps, devices, gateways, fleets
"""
