"""
A live page in a browser. The page of a server shows its values, the last writer of each, a log of
the traffic, and faults; those of fleets, gateways and watched devices show one table.

::

    page             live_page, table_page; HTTP: paths, limits and checks of requests
      page.html, tables.html, page.css, scripts/
    streams          sends rows that have changed to open pages; the source of these rows

    server_source    a server: units, values, log, counters, faults, and their changes
      units          the units of a server, with rows of their points and cells
      log            transactions as text, and the last write to each address

    table_source     a table: its search, charts of its rows, rows of values
      samples        the last numbers of a value, in few bytes, and their gaps
      text           values and names as the text of a cell
"""
