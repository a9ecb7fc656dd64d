"""
Bytes and values, for both ends. No socket, no clock, no event loop, no libmodbus.

Bottom up:

    errors     the exceptions, grouped by cause
    mistakes   errors about arguments: the path of a wrong value, and close names
               (other_names: names of other packages, and what is typed here in their place)
    checks     what callers pass: numbers, durations, functions; what is logged when one fails
    words      the names of types and orders, and vendors' words for them; references such as 40123
    logs       loggers whose handlers may fail
    scan       the CRC, and where RTU frames begin and end; in C (scan.c)
    pdu        one class for each function: encode and decode, request and response
    rtu        cuts RTU frames out of a stream, for clients, servers and listeners
    frames     frames, the base of framers; unit and PDU as bytes on TCP and UDP, and back
    framing    the same on RTU and ASCII lines
    echo       the local echo of a line among received bytes
    tables     the four tables: what they contain, how much of it a request may carry, and ranges
    values     numbers, text, bits and times in registers
               (value_types: what they have in common, numbers and bits; times: the
               forms of dates and times)
    plain      values as text: as people read and type them, in JSON, for terminals
    json_text  the encoders of JSON
"""
