"""
A modem with a meter behind it, for trying listen+tcp://: it connects to the client, says who it
is, and answers reads of registers with their addresses.

    python3 modem.py [PORT]        1502 unless given; Ctrl-C ends it
"""

import contextlib
import socket
import struct
import sys
import time

IMEI, HEARTBEAT, INTERVAL = b"865123456789012", b"ping", 5.0


def serve(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port), INTERVAL) as client:
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


while True:
    with contextlib.suppress(OSError):  # nobody listens, or the client has hung up
        serve(int(sys.argv[1]) if len(sys.argv) > 1 else 1502)
    time.sleep(0.2)
