"""
Servers, lines and a pytest plugin for tests, also for those of other programs, and for the demo.

    wires        a serial line and a TCP relay, which record all bytes; ends of pseudo-terminals
    plugin       for pytest: fixtures, and transactions in the reports of tests that fail
    recording    servers that serve at once, and record their requests and responses
"""
