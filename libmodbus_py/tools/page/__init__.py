"""
A live page in a browser. The page of a server shows its values, the last writer of each, a log of
the traffic, and faults; those of fleets, gateways and watched devices show one table.

`page` is HTTP, and `streams` sends rows that have changed. They come from a `server_source`, with
the rows of its `units`, or from a `table_source`; from `log`, `samples` and `text`.
"""
