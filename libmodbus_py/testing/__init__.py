"""
What tests and the demo use, and other programs' tests may.

    wires    a serial line and a TCP relay with a tap, which record what passes
"""
