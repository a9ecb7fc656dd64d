"""
Modbus Security: who may talk, proven by certificates. No socket.

::

    role          what a certificate says its holder is
    making        authorities and certificates for trying things out, and for tests
    extra         the package cryptography, which this folder asks for when it is needed
"""
