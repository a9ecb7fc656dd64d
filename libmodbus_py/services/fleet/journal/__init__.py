"""
The journal of a fleet: readings on the disk, from which outputs are supplied.

::

    place           the readings that wait for one output: JournalPlace
    tail            the newest readings, in memory
    journal_file    the file, an SQLite database: writing and deleting
    journal_reader  the file: readings for outputs that are behind, and histories
    polls           polls as rows
    numbers         the ids of readings
    errors          the errors of journals
"""
