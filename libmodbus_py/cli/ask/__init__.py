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
    units            several units, asked one after the other
    identify         identify
    diagnose         diagnose
    report           answers to several functions, as identify and diagnose print them
    raw              raw
    map              the arguments of map
    map_check        map check
    map_class        map class
    map_from_device  map from-device
    map_from_sunspec map from-sunspec
"""
