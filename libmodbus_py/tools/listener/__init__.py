"""
Listens to the traffic between other devices on a line, and pairs it into transactions.

::

    transaction    the result: a request, its response, and how it ended; counts of results
    pairing        which response belongs to which request, for all tools that show traffic
    separator      cuts bytes into frames and damage, for a line or a connection
    sources        a serial port, and the tap for `between`, which passes bytes on, both ways
    capture        writes pcapng files, which Wireshark decodes, and reads them
    listener       listen(url): an iterator, blocking and asyncio
"""
