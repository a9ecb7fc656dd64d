"""
Workers on several machines that share the devices of a fleet: each device is polled by one worker.

::

    polling        runs a worker with a clock, a bucket and a fleet
    pushing        writes a fleet file to the bucket; only records that differ are written
    stream         the stream of readings, and the subjects of messages
    commands       writes to points by name, answered by the worker that polls the device
    status         the workers, their slots, and the parts of the fleet that no worker serves

Decisions, without sockets or clocks::

    worker         decides about its lease, its slots and the connections that it may poll
    locations      which worker polls a device
    unserved       connections that no worker polls
    sharing        which worker should hold each slot
    lease          the lease of a worker, as the worker itself counts it
    view           the known contents of the bucket, with the times of changes
    records        the keys and values of the bucket
"""
