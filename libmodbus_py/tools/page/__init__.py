"""
A live page: of a server, with its values, the last writer of each, a log of the traffic, and
faults; or of tables of values that arrive, as those of a fleet.

::

    page             live_page, table_page: a page while a block runs
    web              HTTP: paths, and limits of requests
      guard          ... the checks of token, Host and Origin
      page.html, tables.html, page.css, tables.css, scripts/
    streams          the changes that every open page is sent, ten times a second at most
    source           the protocols of what is shown

    server_source    a server: units, values, log, counters, faults
      actions        ... set a value, switch a fault
      views          the points or cells that a page shows, and which of them have changed
      refreshing     values that a device computes when they are read
      shown          the units of a server, with their tables and points
      setting        typed values, into cells
      fault_list     faults on and off
      log            transactions as text, and the last write to each address

    table_source     tables: the rows that a page looks at, and the history of a value
      tables         columns, rows and values
      samples        the last numbers of a value, in few bytes
      row_history    numbers of rows over time, made of counters
"""
