"""
The registers of a device, by name, and the requests that read and write them. No I/O.

::

    register_map   the points of a device: RegisterMap, load_map; with a client: BoundMap
    map_file       the points of a file: TOML, or a list; MapError
    lists          register lists as vendors publish them: rows, arguments of points
    list_cells     which of their headings means what, and the readers of their cells
    list_words     the words of their headings and cells, from list_words.toml: ListOptions
    point          one named value: Point; the names of points as attributes
    point_checks   the checks of its arguments
    meaning        cells to values and back: no value, states, bits, parts: Meaning, Judged,
                   NoValue
    scaling        raw numbers to scaled ones: Scaling; the names of numbers: States
    items          what a plan reads, and its values by name: Read, NamedValues
    plan           few requests of many reads: Plan
    point_plan     the same for points, and for points that scale them: PointPlan
    refusals       the items that a device refuses, found by halving
    watched        the points of a map from poll to poll: those that are due, and totals
    writing        values of points and registers from typed text; few requests of many writes
"""
