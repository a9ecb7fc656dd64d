"""
Finds the SunSpec models of a device, and turns them into register maps.

::

    chain        the walk from the marker to the end model: requests and decisions, no I/O
    points       the points of one definition: scale factors, states, bits, repeated groups
    device       SunSpecDevice, SunSpecModel: what was found
    discovery    discover: for both clients; the definitions of models, files of pysunspec2
"""
