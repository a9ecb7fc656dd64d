"""
The connection with NATS, which workers use.

::

    connection     a connection, its credentials from files and the environment, its errors
    client         nats-py's client, made to survive what servers and other clients send
    buckets        key-value buckets and streams: created, checked, watched, written
"""
