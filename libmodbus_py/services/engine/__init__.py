"""
The connection with NATS, which workers and the output `nats` use.

::

    connection     a connection, with what the environment says of certificates and passwords
    client         nats-py's client, made to survive what servers and other clients send
    file_text      files with credentials, which are read again
    errors         what is wrong, in one line
    buckets        key-value buckets and streams: made, checked, watched, written to
"""
