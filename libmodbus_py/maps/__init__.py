"""
What registers a device has, by name, and what to ask for all of them. No I/O but of files.

::

    map_file       a register map from a file; load_map
      toml_form    ... in TOML
      csv_form     ... in CSV, as vendors give it
      cells        ... what their cells become
      words        ... and the words in these
    checking       what is right in it, but may not be meant
    texts          and back: a map as text
      drafts       what a file says of a point, and what is wrong with it; MapError
    register_map   the points of a device: RegisterMap
    point          one named value: Point
    scaling        raw numbers and what they stand for
    plan           few requests of many reads: Plan, Read
    writing        few requests of many writes
"""
