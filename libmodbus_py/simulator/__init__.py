"""
Simulated devices, described in a file.

::

    device_file    TOML to devices and faults; every mistake is told with its line
    bounded_toml   TOML within bounds: its size, its depth, its numbers and texts
    roles          who may read and write what, by the roles in certificates
    toml_lines     where in the text a key stands
    behaviour      values that move by themselves: counters, waves, walks, copies
"""
