"""
The command line, on top of everything: arguments become requests and servers.

::

    main           the entry point, and how a command ends: errors, exit codes, SIGTERM
    commands       every command, and the arguments that are typed
    parser         the parser of a command: how its arguments are declared, and its --help
    foreign        words of other programs, and what is typed in place of them
    arguments      arguments of several commands; endpoints and clients
    output         standard output and error, files: messages, JSON, styles
    logs           the log of commands that run for long
    tracing        --verbose: frames in columns
    ask            read, write, identify, diagnose, raw, map
    find           scan, ports, sunspec, listen
    serve          serve, gateway, poll, fleet
    certificates   certificates: for trials, or of the machines of a fleet
    completion     completion: scripts for shells, and the answers to their questions
    token          token: a secret for the live page of a command
    demo           demo: worked examples on three kinds of lines, with the bytes sent
"""
