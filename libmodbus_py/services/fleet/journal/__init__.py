"""
The journal of a fleet: readings on the disk, from which outputs are supplied.

::

    journal         Journal, to which a fleet writes: a task that empties it into the file
    place           the readings that wait for one output: JournalPlace
    recent          the newest readings, in memory
    journal_file    the file, an SQLite database: writing and deleting
    journal_reader  the file: readings for outputs that are behind, and histories
    schema          its tables
    polls           polls as rows
    numbers         the ids of readings
    errors          the errors of journals
"""
