"""
Commands that ask one device: read, write, identify, diagnose, raw and map.

::

    values           the arguments of read and write
    reading          read, once
    watching         read, again and again
    item_plan        the requests of several items
    writing          the requests of write
    items            what is read or written, as words and as requests
    formatters       values as lines, cells of CSV and fields of JSON, and what prints them
    units            several units, asked one after the other, and reports of their answers
    shown_watch      the values of read --watch as the live page shows them
    reports          identify, diagnose and raw
    map              the arguments of map
    map_actions      its actions
"""
