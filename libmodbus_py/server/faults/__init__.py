"""
Faults in the answers of a server, for simulations.

::

    fault      Fault: one kind of fault, with its probability and duration
    switch     FaultSwitch: faults of a running server, on and off, for several users
    due        which fault is due for a request
    faulty     FaultyAnswers: answers of devices, changed by the fault that is due
    delivery   the bytes of a faulty answer, and when they go
"""
