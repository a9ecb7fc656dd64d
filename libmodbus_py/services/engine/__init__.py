"""
The connection with NATS, which workers use.

::

    connection     a connection, with certificates and passwords from files and the environment
    client         nats-py's client, made to survive what servers and other clients send
    errors         the errors of NATS, each explained in one line
    buckets        key-value buckets and streams: created, checked, watched, written
"""
