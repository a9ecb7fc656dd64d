"""
What tests and the demo use, and other programs' tests may.

    wires           a serial line and a TCP relay with a tap, which record what passes
    line_ends       the far ends of lines that are pseudo-terminals
    plugin          for pytest: fixtures, and transactions in the reports of tests that fail
    recording       servers that are there at once, and keep what passed
    fault_switch    the server's own switch of its faults, for imports by tests
    exchanges       what a server received and sent, as transactions
"""
