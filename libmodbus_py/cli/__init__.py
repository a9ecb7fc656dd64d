"""
The command line, on top of everything: what is typed becomes requests and servers.

::

    main          what was typed, and with which exit code it ends
    read_write    read and write: a place, values as text, one request
    security      the options for tls:// of them all
    serve         serve: a device file, limits, until a signal
    scan          scan: who answers at which settings, and what they have
    listen        listen: what others say on a line, until Ctrl-C
    certificates  certificates: an authority, a server and clients with roles
    demo          demo: worked examples on three lines, with the bytes that a tap saw
"""
