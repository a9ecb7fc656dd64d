"""
The command line, on top of everything: what is typed becomes requests and servers.

::

    main          the entry: with which exit code it ends
    commands      every command, and the parser of what was typed
    help          how --help is set
    output        standard output and error, whatever they are
    failing       what went wrong: a line, and an exit code
    read          read: what it takes
      reading     ... the requests, and what they gave
      watching    ... again and again
      table       ... on a terminal, in its place
      lines       ... a line for each poll
    write         write: what it takes
      writing     ... a request for each item
    identify      identify: what it takes; diagnose and raw likewise
      telling     ... what a device says of itself, and to any function
    items         tables, references and names, as they are typed
    asking        the requests for items
    views         what was read, as rows and fields of JSON
    connecting    whom clients ask: URLs, hosts, serial ports
    tracing       -v: frames in columns
    status        how far long work has come
    security      the options for tls:// of them all
    limits        the options that say what clients may cost; metrics: for Prometheus
    page          the option for a live page; addresses: HOST:PORT, as typed
    announcing    where a server listens, and who may come
    hangup        what SIGHUP means: a file to read again, or a terminal that closed
    serve         serve: a device file, until a signal
    gateway       gateway: routes or a gateway file, until a signal
    poll          poll: a fleet file, until a signal
    workers       poll --engine: one of several machines; fleet: about all of them
    scan          scan: who answers at which settings, and what they have
    map           map: register maps, checked, or made of what a device has
    listen        listen: what others say on a line, until Ctrl-C
    certificates  certificates: an authority, a server and clients with roles
    completion    completion: for shells, and what they are told
    demo          demo: worked examples on three lines, with the bytes that a tap saw
"""
