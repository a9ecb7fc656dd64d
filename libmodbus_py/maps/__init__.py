"""
The registers of a device, by name, and the requests that read and write them. No I/O.

::

    register_map   the points of a device: RegisterMap
    point          one named value: Point
    bounds         minimum and maximum of values that a client wrote
    scaling        raw numbers and what they stand for
    plan           few requests of many reads: Plan, Read
    typed          values of points and registers from typed text
    writing        few requests of many writes
"""
