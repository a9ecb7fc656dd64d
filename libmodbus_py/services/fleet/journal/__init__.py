"""
The journal of a fleet: readings on the disk, from which outputs are supplied.

::

    journal         Journal, to which a fleet writes: a task that empties it into the file
    place           the readings that wait: the newest ones in memory, and those of one output
    journal_file    the file, an SQLite database: writing, reading for outputs, and deleting
    journal_reader  the past of a value, for charts
    schema          its tables, polls as rows, the ids of readings, and errors
"""
