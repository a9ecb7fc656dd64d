"""
Files that describe devices, gateways and fleets, and register maps: readers and checks.

::

    texts        reading a file, the line of each key of TOML, and mistakes with their place
    schema       the keys of tables: a row for each, and the checks of their values; rights of roles
    csv_text     CSV: headings, rows, cells
    maps         register maps
"""
