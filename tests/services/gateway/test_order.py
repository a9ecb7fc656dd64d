"""
A gateway keeps the order of a read and the write behind it, whatever delays the read.
"""

import socket

from libmodbus_py import Device, Gateway, Mapping, Route, Server, ServerDeviceBusy
from tests.services.gateway.gates import adu
from tests.support.cases import each_case

READ, WRITE = bytes.fromhex("03 0001 0001"), bytes.fromhex("06 0001 004D")


@each_case(
    "target", ["tcp?busy_retries=1", "tcp?busy_retries=1&max_in_flight=4", "rtu+tcp?busy_retries=1"]
)
def test_a_write_waits_for_the_repetition_of_the_read_before_it(target: str) -> None:
    """Both requests arrive together; the device is busy when the read comes first."""
    busy = [True]

    def before_read(access: object) -> None:
        if busy:
            busy.pop()
            raise ServerDeviceBusy

    scheme, _, options = target.partition("?")
    device = Device(Mapping(holding_registers={0: [0, 5]}), before_read=before_read)
    with Server(device).background(f"{scheme}://127.0.0.1:0") as behind:
        gateway = Gateway([Route(f"{behind.urls[0]}?{options}")])
        with gateway.background("tcp://127.0.0.1:0") as running:
            host, port = running.urls[0].removeprefix("tcp://").split(":")
            with socket.create_connection((host, int(port)), timeout=10) as client:
                client.sendall(adu(READ, 1) + adu(WRITE, 2))
                expected = adu(bytes.fromhex("03 02 0005"), 1) + adu(WRITE, 2)
                assert client.makefile("rb").read(len(expected)) == expected
