"""
Finds the units that answer, and the registers that they have, by reading alone.

::

    probe       the settings of a line, and one request to one unit; Walker: an iterator over these
    scan        Scan: all units at all settings; Found: one that answered
    search      Search: the tables of one unit; Extent: the ranges of one of them
"""
