"""
A live page in a browser. The page of a server shows its values, the last writer of each, a log of
the traffic, and faults; other pages show tables of values, such as those of a fleet.

::

    page             live_page, table_page: serve a page while a block runs
    web              HTTP: paths, and limits of requests
      guard          checks the token, Host and Origin of requests
      page.html, tables.html, page.css, tables.css, scripts/
    streams          sends changes to open pages, at most ten times a second
    source           the protocols between a page and the things that it shows

    server_source    a server: units, values, log, counters, faults
      actions        the requests of a page: set a value, switch a fault
      views          the points or cells that a page shows, and which of them have changed
      refreshing     values that a device computes when they are read
      shown          the units of a server, with their tables and points
      setting        sets cells to values that a person typed
      fault_list     switches faults on and off
      log            transactions as text, and the last write to each address

    table_source     tables: the rows that a page shows, and the history of a value
      tables         columns, rows and values
      samples        the last numbers of a value, in few bytes
      row_history    numbers of rows over time, computed from counters
"""
