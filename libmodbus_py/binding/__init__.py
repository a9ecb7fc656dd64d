"""
libmodbus: its build, its functions, its errors as exceptions, and modbus_reply in memory.

    _libmodbus.h, .c    what cffi declares and compiles; weak names for functions newer than 3.1.6
    answer_chunk.c      the server's short way: received bytes in, answers out, in one call
    library             the one import of the compiled module; errno as exceptions; modbus_reply
"""
