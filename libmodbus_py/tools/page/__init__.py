"""
A live page of a server: what its devices hold, who wrote it, what passed, and what goes wrong.

::

    page           live_page: a page while a block runs
    web            HTTP: who may ask, what, and how much of it
      guard        ... the token, the Host and the Origin
      page.html, page.css, scripts/
    actions        what a page asks for: to look elsewhere, to set, to switch
    streams        what every open page is sent, ten times a second at most
    views          what a page looks at: points by name, or cells; what changed of it
    refreshing     values that are computed when they are looked at
    shown          what there is: units, tables, points
    setting        a value that was typed, into its cells
    fault_list     faults on and off
    log            what passed, as text, and who wrote what last
"""
