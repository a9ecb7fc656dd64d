"""
Modbus Security: TLS with certificates on both sides. No socket.

::

    security      Security: the own certificate, and the trusted ones
    files         certificates, keys and pins in PEM files
    loaded        Loaded: what the files contain, and OpenSSL's settings made of it
    revoked       Revoked: revocation lists
    renewed       Renewed: values read from files, and read again
    acceptance    Acceptance: whether the certificate of an open connection is still good
    given         GivenContext: a context of Python's ssl that the application has made
    tunnel        Tunnel: one TLS connection, bytes in and bytes out; Records: where they end
    role          the role in a certificate
    describing    a certificate as text, for error messages
    words         errors of OpenSSL in words
    extra         the package cryptography, imported when it is needed
"""
