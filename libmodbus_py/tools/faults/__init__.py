"""
Servers with faults in their answers, for simulations and tests.

::

    server     Server: devices, and faults in their responses, with their bytes and times
    fault      Fault: one kind, with its probability and duration; FaultSwitch: on and off
"""
