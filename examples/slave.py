"""
A slave in 20 lines, as libmodbus has them in C: one master at a time, any unit.

    python3 examples/slave.py [PORT]        1502 unless given; Ctrl-C ends it
"""

import contextlib
import sys

from libmodbus_py import Mapping, ModbusError, TcpContext

mapping = Mapping(coils=100, discrete_inputs=100, holding_registers=100, input_registers=100)
slave = TcpContext("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 1502)
slave.listen()
print("listening on port", slave.port, flush=True)

with contextlib.suppress(KeyboardInterrupt):
    while True:
        print("a master:", slave.accept(), flush=True)
        try:
            while True:
                if request := slave.receive():
                    slave.reply(request, mapping)
        except ModbusError as error:
            print(error, flush=True)
