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
    holes          the items that a device refuses, found by halving
    typed          values of points and registers from typed text
    writing        few requests of many writes
"""
