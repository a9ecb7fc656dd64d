"""
Register maps in files, in TOML and in CSV.

::

    map_file    load_map: a register map from a file
    toml_form   a map in TOML
    csv_form    a map in CSV, as vendors publish it
    cells       what the cells of a row become
    words       the words that vendors use in headings and cells
    drafts      what a file says of points, made into points; MapError
    checking    doubts about a map that can be read
    texts       a map as text
"""
