"""
Servers with faults in their answers, for simulations and tests.

::

    server     Server: devices, and faults in their responses
    fault      Fault: one kind of fault, with its probability and duration
    switch     FaultSwitch: faults of a running server, on and off, for several users
    due        which fault is due for a request, and the answer that it changes
    delivery   the bytes of a faulty answer, and when they are sent
"""
