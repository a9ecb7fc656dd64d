"""
Simulated devices, described in a file.

::

    reloading      a file that is read again while its devices are served
    values_file    the file that keeps the values of devices over a restart
    device_file    TOML to devices and faults; DeviceFileError
    units          one unit of it: a device
    simulated      SimulatedDevice: a device with named points, which can take over values of
                   another
    mapped         points from register maps
    own_points     points described in the device file itself
    shared_registers  points that are different bits of the same registers
    keys           all keys of device files
    clockwork      computes values that move when they are read
    behaviour      ... by counters, waves, walks, copies
    simulated_point  SimulatedPoint: a point with its first values and its behaviour
    example_files  the device files in examples/, by name
"""
