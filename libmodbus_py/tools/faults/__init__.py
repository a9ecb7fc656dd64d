"""
Servers with faults in their answers, for simulations and tests.

::

    server     Server: devices, and faults in their responses
    fault      Fault: one kind, with its probability and duration; FaultSwitch: on and off
    answers    which fault is due for a request, the bytes that it makes, and when they are sent
"""
