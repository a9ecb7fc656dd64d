"""
Files that people write: how they are read, and where a mistake in them is.

::

    texts       reading a file, the line of each key of TOML, and mistakes with their place
    schema      the keys of tables: a row for each, and the checks of values
    csv_text    CSV and Markdown: headings, rows, cells
"""
