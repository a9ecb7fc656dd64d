"""
Commands that ask one device: read, write, identify, diagnose, raw and map.

::

    read          the options of read
    reading       the requests of read, and what they gave
    watching      reading again and again
    table         ... on a terminal, in place
    lines         ... a line for each poll
    write         the options of write
    writing       a request for each item
    identify      identify; diagnose and raw likewise
    telling       what a device says of itself, and to any function
    items         tables, references and names, as they are typed
    asking        the requests for items
    views         what was read, as rows and fields of JSON
    map           register maps, checked, or made of what a device has
"""
