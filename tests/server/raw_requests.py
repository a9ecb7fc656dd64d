"""
Requests as bytes on plain sockets, for the tests of servers.
"""

from __future__ import annotations

import socket
import struct

from libmodbus_py import pdu

READ = pdu.ReadHoldingRegisters(100, 2).encode()
READ_ANSWER = bytes.fromhex("0304 03e8 03e9")


def connect(port: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), 5)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def adu(body: bytes, transaction: int = 1, unit: int = 17, **changed: int) -> bytes:
    header = {"transaction": transaction, "protocol": 0, "length": 1 + len(body), "unit": unit}
    return struct.pack(">HHHB", *(header | changed).values()) + body


def receive(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        if not piece:
            break
        data += piece
    return data
