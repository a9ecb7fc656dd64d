"""
Simulated devices, described in a file.

::

    device_file    TOML to devices and faults, with the keys of files; DeviceFileError
    points         points described in the device file itself, or in register maps
    movements      computes values that move: counters, waves, walks, copies
    simulated      SimulatedDevice: a device with named points, which can take over values of
                   another; Simulation: all devices of a file
    reloading      a file that is read again while its devices are served
    hooks_file     hooks in a file of Python, for all devices
    example_files  the device files in examples/, by name
"""
