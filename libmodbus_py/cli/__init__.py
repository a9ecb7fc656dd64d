"""
The command line, on top of everything: what is typed becomes requests and servers.

::

    main           the entry: with which exit code it ends
    commands       every command, and the parser of what was typed
    help           how --help is set
    output         standard output and error, whatever they are
    failing        what went wrong: a line, and an exit code
    connecting     whom clients ask: URLs, hosts, serial ports
    security       the options for tls:// of all commands
    tracing        -v: frames in columns
    status         how far long work has come
    ask            read, write, identify, diagnose, raw, map
    find           scan, listen
    serve          serve, gateway, poll, fleet
    certificates   certificates: an authority, a server and clients with roles
    completion     completion: for shells, and what they are told
    demo           demo: worked examples on three lines, with the bytes that a tap saw
"""
