"""
Workers on several machines that share the devices of a fleet: each is polled by one.

::

    polling        a worker with its clock, its bucket and its fleet
    pushing        a fleet file into the bucket: only what changed
    commands       writes by name, answered by who has the device
    status         who is there, who has what, and what nobody serves

Decided without sockets and clocks::

    worker         its lease, its slots, and whom it may ask; and why none is asked by two
    locations    where a device is that one does not have
    sharing        who should have which slots
    lease          how a worker counts its own lease
    view           what one has seen of the bucket, and when
    records        what stands in the bucket: keys and values
"""
