"""
Bytes and values, for both ends. No socket, no clock, no event loop, no libmodbus.

Bottom up:

    errors     the exceptions, grouped by cause
    mistakes   errors that know where the wrong value stands
    checks     numbers that callers give
    callbacks  functions of users: which are refused, and what is logged when one fails
    logs       loggers whose handlers may fail
    pdu        one class for each function: encode and decode, request and response
    scan       the CRC, and where RTU frames begin and end; in C (scan.c)
    pauses     the silence between frames on a serial line
    rtu        where RTU frames begin and end, for clients, servers and listeners
    frames     frames, and the base of framers
    framing    unit and PDU as bytes on TCP, UDP, RTU and ASCII lines, and back
    echo       the local echo of a line among received bytes
    words      the words of tables, types and orders, as vendors write them
    close_names  names that are close to one that is not known
    tables     the four tables: what they hold, and how much of it a request may carry
    values     numbers, text, bits and times in registers; references such as 40123
               (type_names: what type checkers know of them)
    times      dates and times in registers
               (local_times: those of devices whose clocks show local time)
    durations  seconds, as people type them
    shown_time  points in time, as outputs show them
    spelling   values as people read and type them
    plain      values as JSON can contain them
    json_text  the encoders of JSON
"""
