"""
Files that describe devices, gateways and fleets, and register maps: readers and checks.

::

    texts         reading a file, the line of each key of TOML, and mistakes with their place
    schema        the keys of tables: a row for each, and the checks of values; rights of roles
    csv_text      CSV: headings, rows, cells
    map_file      load_map: a register map from a file: TOML, or CSV as vendors publish it
    map_contents  the points of such a file, and its mistakes; MapError
    map_texts     a map as text: a file, or a Python class
"""
