"""
Register maps in files, in TOML and in CSV.

::

    map_file    load_map: a register map from a file: TOML, or CSV as vendors publish it
    contents    the points of a file, and its mistakes; MapError
    texts       a map as text: a file, or a Python class
"""
