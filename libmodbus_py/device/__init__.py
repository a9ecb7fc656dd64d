"""
One unit: request PDU in, response PDU out. No socket.

In the order in which a request goes through::

    device         Device: checks, hooks and handlers, and the functions libmodbus lacks
    authorization  Guard: asks about each request before anything else, and says who was refused
    rules          Rules: who may do what, as a table
    event_log      EventLog: counters, log and silence of one line (functions 8, 11, 12)
    hooks          Hook: the application's functions, for which accesses, how long they take
    access         what a request touches, as hooks see it
    reply          Replier: libmodbus's modbus_reply in memory, by the chunk
    mapping        Mapping: the four tables that it answers from, with their holes
    ranges         ranges of addresses, joined
    record_file    RecordFile: the records of functions 20 and 21
"""
