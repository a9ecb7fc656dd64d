"""
Faults in the answers of a server, for simulations and tests.

::

    fault      Fault: one kind, with its probability and duration, and the bytes that it makes
"""
