"""
The command line, on top of everything: arguments become requests and servers.

::

    main           the entry point, and the exit codes
    commands       every command, and the parser of the arguments
    foreign        words of other programs, and what is typed in place of them
    help           the layout of --help and --help-all
    arguments      the arguments that several commands take, each declared once; what completes them
    connecting     endpoints and clients, made of URLs and options
    output         standard output and error, files: messages, JSON, styles
    failing        how a command ends: errors, exit codes, SIGTERM
    logs           the log of commands that run for long
    tracing        --verbose: frames in columns
    screen         a status line, lines that are drawn again in place, progress
    ask            read, write, identify, diagnose, raw, map
    find           scan, ports, sunspec, listen
    serve          serve, gateway, poll, fleet
    certificates   certificates: for trials, or of the machines of a fleet
    completion     completion: scripts for shells, and the answers to their questions
    demo           demo: worked examples on three kinds of lines, with the bytes sent
"""
