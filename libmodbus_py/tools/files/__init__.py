"""
Files that describe devices, gateways and fleets, and register maps: readers and checks.

::

    texts       reading a file, the line of each key of TOML, and mistakes with their place
    schema      the keys of tables: a row for each, and the checks of values; rights of roles
    csv_text    CSV: headings, rows, cells
    map_file    load_map: the points of a file: TOML, or CSV as vendors publish it; MapError
    map_texts   a map as text: a file, or a Python class
"""
