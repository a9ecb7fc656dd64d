"""
A live page of a server: its values, the last writer of each, a log of the traffic, and faults.

::

    page           live_page: a page while a block runs
    web            HTTP: paths, and limits of requests
      guard        ... the checks of token, Host and Origin
      page.html, page.css, scripts/
    actions        requests of a page: choose another view, set a value, switch a fault
    streams        the changes that every open page is sent, ten times a second at most
    views          the points or cells that a page shows, and which of them have changed
    refreshing     values that a device computes when they are read
    shown          the units of a server, with their tables and points
    setting        typed values, into cells
    fault_list     faults on and off
    log            transactions as text, and the last write to each address
"""
