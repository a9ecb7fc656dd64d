"""
Workers on several machines that share the devices of a fleet: each device is polled by one worker.

::

    polling        runs a worker with a clock, a bucket and a fleet
    messages       the stream of readings, and writes to points by name; subjects
    contents       the whole bucket: a push writes what differs in it, the status shows what it has

Decisions, without sockets or clocks::

    decisions      what a worker polls, what it writes, and when it looks again; why that is safe
    worker         what a worker knows: the bucket as it sees it, its lease and its own writes
    records        the keys and values of the bucket, and its known contents with their times
"""
