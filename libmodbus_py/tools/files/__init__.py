"""
What stands in files, whatever it describes.

::

    texts        a file, read and made something of; every mistake is told with its line
    rereading    a file that is read again while a program uses what it said before
    toml_text    TOML within bounds: its size, its depth, its numbers and texts
    toml_lines   where in the text a key stands
    tables       what a table may hold
    roles        who may read and write what, by the roles in certificates
    maps         register maps
"""
