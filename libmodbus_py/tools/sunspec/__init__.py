"""
Finds the SunSpec models of a device, and turns them into register maps.

::

    definitions  the definitions of models, from the JSON files of pysunspec2
    chain        the walk from the marker to the end model: requests and decisions, no I/O
    points       the points of one definition: scale factors, states, bits, repeated groups
    device       SunSpecDevice, SunSpecModel: what was found
    discovery    discover: for both clients
"""
