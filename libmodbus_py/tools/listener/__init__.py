"""
Who only listens: what others say on a line, as transactions.

::

    transaction    what is given: a question, its answer, and how it ended
    hearing        bytes and times in; frames that may be either, and bytes that are none, out
    outcome        what a frame says, once it is known whether it asks or answers
    pairing        which of them are requests, and whose answers the others are; learnt times
    separator      both, for a line or for a connection; no clock, no port
    summary        counts: units, functions, answer times, errors
    source         where bytes come from: what all have in common, and a serial port
    tap            between: passes bytes on, both ways, and shows them
    capture        pcapng, written so that Wireshark decodes it, and read again
    listening      listening(url): an iterator, blocking and asyncio
"""
