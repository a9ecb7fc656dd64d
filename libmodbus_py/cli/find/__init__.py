"""
Commands that find out what is on a line or in a network.

::

    scan     the units that answer, their settings and tables; ranges of hosts
    ports    the serial ports of this machine
    sunspec  the SunSpec models of a device, and their values
    listen   the traffic between other devices, until Ctrl-C
"""
