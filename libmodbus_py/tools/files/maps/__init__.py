"""
Register maps in files, in TOML and in CSV.

::

    map_file    load_map: a register map from a file
    toml_form   a map in TOML
    csv_form    a map in CSV, as vendors publish it
    cells        readers for the cells of a row
    words       the words that vendors use in headings and cells
    drafts       unchecked points of a file, made into points; MapError
    checking    doubts about a map that can be read
    texts       a map as text
"""
