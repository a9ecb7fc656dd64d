"""
Modbus Security: who may talk, proven by certificates. No socket.

::

    security      Security: who one is, and whom one trusts
    given        GivenContext: a context of Python's ssl that somebody else has made
    tunnel        Tunnel: one TLS connection, bytes in and bytes out; Records: where they end
    role          what a certificate says its holder is
    describing    what a certificate says of itself, for error messages
    words         errors of OpenSSL in words
    extra         the package cryptography, which this folder asks for when it is needed
"""
