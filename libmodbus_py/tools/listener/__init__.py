"""
Listens to what others say on a line, and pairs it into transactions.

::

    transaction    the result: a request, its response, and how it ended
    outcome       frames decoded, once they are known to be requests or responses
    pairing        which response belongs to which request; for all that shows or records traffic
    traces         ... from the trace of a server or a client
    hearing        bytes and times in; frames that may be either, and bytes that are none, out
    naming         which of these frames are requests and which are responses; learnt times
    separator      all of this for a line or a connection; no clock, no port
    summary        counts: units, functions, answer times, errors
    source         where bytes come from: what all have in common, and a serial port
    tap            between: passes bytes on, both ways, and shows them
    link           ... one connection of a tap
    capture        pcapng, written so that Wireshark decodes it, and read again
    listener       listen(url): an iterator, blocking and asyncio
"""
