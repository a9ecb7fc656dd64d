"""
One unit: request PDU in, response PDU out. No socket.

In the order in which a request goes through::

    device         Device: checks, hooks and handlers, and the functions libmodbus lacks
    caller         Caller: the origin of a request, and who records what it changes
    auditing       requests that change a device, for an audit trail
    authorization  Authorization: decides about each request first, and logs refusals
    rules          Rules: access rights of roles, as a table
    event_log      EventLog: counters, log and silence of one line (functions 8, 11, 12)
    point_rules    access and bounds of points, before any hook
    point_index    points by the addresses of their cells
    named_values   values by the names of points
    hooks          Hook: functions of the application, the accesses they are for, their duration
    access         tables and addresses that a request touches, as hooks see them
    reply          Replier: libmodbus's modbus_reply in memory, by the chunk
    mapping        Mapping: the four tables of a device, with their holes
    state          the values of devices in a file, and back
    ranges         ranges of addresses, joined
    record_file    RecordFile: the records of functions 20 and 21
"""
