"""
What goes wrong with the answers of a server, where a simulation wants it.

::

    fault      Fault: one kind of fault, with its probability and duration
    due        which fault is due for a request
    delivery   the bytes of a faulty answer, and when they go
"""
