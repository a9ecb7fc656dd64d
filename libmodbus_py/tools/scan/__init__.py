"""
Who answers where, and what they have: found by reading alone.

::

    places      the settings that a line may have, and how long an answer takes there
    probe       one question to one unit, and what its answer says
    walking     Walker: an iterator that asks, and that can be left
    scan        Scan: all units at all settings; Found: one that answered
    halving     which cells of a table exist, told by what a device lets one read; pure
    search      Search: the tables of one unit; Extent: the ranges of one of them
"""
