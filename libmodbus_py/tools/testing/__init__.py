"""
For tests, those of other programs included, and for the demo.

    wires           a serial line and a TCP relay, which record all bytes
    line_ends       the far ends of lines that are pseudo-terminals
    plugin          for pytest: fixtures, and transactions in the reports of tests that fail
    recording       servers that serve at once, and record their transactions
    fault_switch    the server's own switch of its faults, for imports by tests
    exchanges       the requests and responses of a server, as transactions
"""
