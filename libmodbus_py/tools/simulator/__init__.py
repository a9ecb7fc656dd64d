"""
Simulated devices, described in a file.

::

    reloading      a file that is read again while its devices are served
    device_file    TOML to devices and faults; every mistake is told with its line
    units          one unit of it: a device
    simulated      SimulatedDevice: a device that knows its names, and goes on from another
    access_rules   what clients may not do, and what moves when they read
    mapped         ranges from register maps
    ranges         ranges as the file says them
    keys           all keys, and what may stand behind them
    checks         ... by these checks; DeviceFileError
    clockwork      computes what moves when it is read
    behaviour      how: counters, waves, walks, copies
    runs           what: values with a place and a kind
    example_files  the device files in examples/, by name
"""
