"""
Contexts that are libmodbus: a modbus_t each, with checked arguments, a lock and exceptions.

    context     the base: state, lock, errors, and what modbus.h sets and reads
    functions   one method for each function of libmodbus, and for those that it lacks; answers
                by hand: receive, reply, reply_exception
    tcp         TcpContext: connections, listen and accept
    rtu         RtuContext: the serial port, RTS, silence after a failure
"""
