"""
The registers of a device, by name, and the requests that read and write them. No I/O.

::

    register_map   the points of a device: RegisterMap
    point          one named value: Point
    bound_map      a map with a client: BoundMap
    attribute_names  names of points as attributes of Python classes
    bounds         minimum and maximum of values that a client wrote
    scaling        conversion of raw numbers to scaled ones, and back
    meaning        raw values that mean none, states and named bits: NoValue, Judged
                   (meaning_keys: the keys of points that say so)
    parts          single bits, some bits, a byte of a register
    sources        points that hold the scale of others
    pace           which points are read at a poll
    watched        the points of a map from poll to poll
    totals         totals that are smaller than before
    plan           few requests of many reads: Plan, Read
    plan_run       one run of a plan at a device: its requests, and the search for what it refuses
    strict_run     a run of a plan that ends with the first failure
    holes          the ranges that a device refuses, and when they are tried again
    pieces         the parts of a request that a device may refuse one by one
    block_answers  what a run reads of one request of the plan
    typed          values of points and registers from typed text
    writing        few requests of many writes
"""
