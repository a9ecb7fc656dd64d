"""
Commands that ask one device: read, write, identify, diagnose, raw and map.

::

    read             the arguments of read
    reading          the requests of read, and their results
    watching         read --watch: reading again and again
    shown_watch      the values of read --watch as the live page shows them
    table            ... on a terminal, drawn again in place
    lines            ... elsewhere, a line for each poll
    write            the arguments of write
    writing          the requests of write
    verifying        ... read back, and compared
    items            the words that say what is read or written: tables, references, names
    item_plan        the requests that read items
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
