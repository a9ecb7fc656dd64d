"""
A modem with a meter behind it, for trying listen+tcp://: it connects to the client, says who it
is, and answers reads of registers with their addresses.

    python3 modem.py [PORT [HOST]]        1502 and 127.0.0.1 unless given; Ctrl-C ends it
"""

import contextlib
import socket
import struct
import sys
import time

IMEI, HEARTBEAT, INTERVAL = b"865123456789012", b"ping", 5.0


def serve(port: int, host: str) -> None:
    with socket.create_connection((host, port), INTERVAL) as client:
        client.sendall(IMEI)
        while True:
            try:
                request = client.recv(260)
            except TimeoutError:
                client.sendall(HEARTBEAT)
                continue
            if not request:
                return
            ids, unit, function, address, count = struct.unpack(">4sxxBBHH", request)
            data = struct.pack(f">{count}H", *range(address, address + count))
            head = struct.pack(">4sHBBB", ids, 3 + len(data), unit, function, len(data))
            client.sendall(head + data)


arguments = dict(enumerate(sys.argv))
while True:
    with contextlib.suppress(OSError):  # nobody listens, or the client has hung up
        serve(int(arguments.get(1, 1502)), arguments.get(2, "127.0.0.1"))
    time.sleep(0.2)
