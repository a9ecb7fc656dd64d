"""
The command line, on top of everything: what is typed becomes requests and servers.

::

    main          what was typed, and with which exit code it ends
    read_write    read and write: a place, values as text, one request
    security      the options for tls:// of them all
    limits        the options that say what clients may cost; metrics: for Prometheus
    announcing    where a server listens, and who may come
    serve         serve: a device file, until a signal
    gateway       gateway: routes or a gateway file, until a signal
    scan          scan: who answers at which settings, and what they have
    listen        listen: what others say on a line, until Ctrl-C
    certificates  certificates: an authority, a server and clients with roles
    demo          demo: worked examples on three lines, with the bytes that a tap saw
"""
