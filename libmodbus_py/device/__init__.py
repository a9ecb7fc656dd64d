"""
One unit: request PDU in, response PDU out. No socket.

In the order in which a request goes through::

    device         Device: checks, rules, hooks and handlers of each request, in this order
    authorization  Authorization: decides about each request first, and logs refusals; Rules:
                   access rights of roles, as a table; LimitedLog: warnings that clients cause,
                   a line a minute
    access         tables and addresses that a request touches, as hooks see them; Caller: where it
                   came from, and what an audit records of it
    hooks          Hook: functions of the application, the accesses they are for, their duration
    functions      what libmodbus lacks: files, queues, identification, diagnostics
    records        RecordFile, FifoQueue: what a device has besides its tables
    mapping        Mapping: the four tables of a device, with their holes
    event_log      EventLog: counters, log and silence of one line (functions 8, 11, 12)
    named_values   NamedValues: the values of named points, as a device sees them; PointRules:
                   access and bounds of points for clients, before any hook
    state          the values of devices in a file, and back
"""
