"""
Listens to the traffic between other devices on a line, and pairs it into transactions.

::

    transaction    the result: a request, its response, and how it ended; decoding of known frames
    pairing        which response belongs to which request, for all tools that show traffic
    traces         pairs the trace of a server or a client
    hearing        cuts bytes into frames, which may be requests or responses, and damage
    naming         which of these frames are requests and which are responses
    separator      all of this for a line or a connection, without clocks or ports
    summary        counts: units, functions, answer times, errors
    source         the protocol of all sources of bytes, and a serial port
    tap            the source for `between`: passes bytes on, both ways, and records them
    capture        writes pcapng files, which Wireshark decodes, and reads them
    listener       listen(url): an iterator, blocking and asyncio
"""
