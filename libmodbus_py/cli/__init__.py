"""
The command line, on top of everything: arguments become requests and servers.

::

    main           the entry point, and the exit codes
    terminating    SIGTERM, which ends commands as Ctrl-C does
    commands       every command, and the parser of the arguments
    help           the layout of --help
    arguments      the arguments that several commands take, each declared once
    connecting     endpoints and clients, made of URLs and options
    output         standard output and error: messages, JSON, styles
    failing        errors: a line on stderr, and an exit code
    logs           the log of commands that run for long
    tracing        --verbose: frames in columns
    status         a status line for long work
    redrawn        ... lines that are drawn again in place
    progress       progress and results of scans and searches, in words
    ask            read, write, identify, diagnose, raw, map
    find           scan, ports, sunspec, listen
    serve          serve, gateway, poll, fleet
    certificates   certificates: of an authority, a server and clients with roles
    completers     ... and what is completed besides commands and options
    completion     completion: scripts for shells, and the answers to their questions
    demo           demo: worked examples on three kinds of lines, with the bytes sent
"""
