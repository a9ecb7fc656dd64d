"""
Finds the units that answer, and the registers that they have, by reading alone.

::

    places      the settings that a line may have, and how long a response takes there
    probe       one request to one unit; Walker: an iterator that sends requests, and can be left
    scan        Scan: all units at all settings; Found: one that answered
    search      Search: the tables of one unit; Extent: the ranges of one of them
"""
