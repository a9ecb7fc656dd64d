"""
What files in TOML have in common, whatever they describe.

::

    files      a file, read and made something of; every mistake is told with its line
    bounded    TOML within bounds: its size, its depth, its numbers and texts
    lines      where in the text a key stands
    tables     what a table may hold
    roles      who may read and write what, by the roles in certificates
"""
