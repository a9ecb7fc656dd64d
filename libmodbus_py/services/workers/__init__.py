"""
Workers on several machines that share the devices of a fleet: each device is polled by one worker.

::

    polling        runs a worker: its clock, its bucket and its fleet
    pushing        writes a fleet file to the bucket: only what changed
    commands       writes to points by name, answered by the worker that polls the device
    status         the workers, their slots, and the parts of the fleet that no worker serves

Decisions, without sockets and clocks::

    worker         its lease, its slots, the connections that it may poll; why no two poll one
    locations      which worker polls a device
    unserved       connections that no worker polls
    sharing        which worker should hold each slot
    lease          the lease of a worker, as the worker itself counts it
    view           the contents of the bucket as far as they are known, with times
    records        the keys and values of the bucket
"""
