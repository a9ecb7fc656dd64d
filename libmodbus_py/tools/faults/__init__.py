"""
Servers with faults in their answers, for simulations and tests.

::

    server     Server: devices, and faults in their responses
    fault      Fault: one kind of fault, with its probability and duration
    switch     FaultSwitch: faults of a running server, on and off, for several users
    answers    which fault is due for a request, the bytes that it makes, and when they are sent
"""
