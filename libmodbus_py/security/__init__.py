"""
Modbus Security: TLS with certificates on both sides. No socket.

::

    security      Security: the own certificate and the trusted ones; GivenContext: an SSLContext;
                  Renewed: values read from files, and read again
    files         certificates, keys, pins and revocation lists in PEM files; Loaded: OpenSSL's
                  settings made of them; Acceptance: of open connections
    tunnel        Tunnel: one TLS connection, bytes in and bytes out; Records: where they end
    certificates  what certificates contain, roles among it, and errors of OpenSSL as text
"""
