"""
Simulated devices, described in a file.

::

    device_file    TOML to devices and faults; every mistake is told with its line
    behaviour      values that move by themselves: counters, waves, walks, copies
"""
