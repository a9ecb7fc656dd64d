"""
Commands that ask one device: read, write, identify, diagnose, raw and map.

::

    read             the arguments of read
    reading          its requests, and its results in each form
    watching         read --watch: again and again, on a terminal in a table
    write            the arguments of write
    writing          the requests of write
    items            what is read or written, as words and as requests
    formatters       values as lines, cells of CSV and fields of JSON
    units            several units, asked one after the other, and reports of their answers
    shown_watch      the values of read --watch as the live page shows them
    identify         identify
    diagnose         diagnose
    raw              raw
    map              the arguments of map, map list and map class
    map_check        map check
    map_making       map from-device and map from-sunspec
"""
