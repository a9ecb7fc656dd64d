"""
Commands that find out what is on a line or in a network.

::

    scan     who answers at which settings, and what they have
    listen   what others say on a line, until Ctrl-C
"""
