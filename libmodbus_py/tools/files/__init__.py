"""
Files that describe devices, gateways and fleets, and register maps: readers and checks.

::

    texts        reading a file, and a TOML document with the line of each key
    schema       the keys of tables: a row for each, and the checks of their values
    file_error   what is wrong in a file: its place, the path of the key, the reason
    amounts      times and sizes with their units: "90 days", "2 GB"
    csv_text     CSV: headings, rows, cells
    roles        rights of roles in certificates
    maps         register maps
"""
