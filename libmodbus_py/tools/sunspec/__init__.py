"""
Finds the SunSpec models of a device, and turns them into register maps.

::

    points       the points of one definition: scale factors, states, bits, repeated groups
    discovery    discover: for both clients; SunSpecDevice, SunSpecModel: what was found
"""
