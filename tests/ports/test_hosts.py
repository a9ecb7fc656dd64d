"""
Which hosts are this machine.
"""

from __future__ import annotations

from libmodbus_py.ports.hosts import is_loopback, is_this_machine
from tests.support.cases import each_case

LOOPBACK = ["localhost", "LOCALHOST", "ip6-localhost", "127.0.0.1", "127.255.0.9", "127.1"]
LOOPBACK += ["::1", "::1%lo", "::ffff:127.0.0.1"]

OTHERS = ["192.0.2.1", "2001:db8::1", "::ffff:192.0.2.1", "fe80::1%eth0", "128.0.0.1", ""]
OTHERS += ["plant.example", "127.example", "localhost.example"]


@each_case("host", LOOPBACK)
def test_only_this_machine_reaches_loopback(host: str) -> None:
    assert is_loopback(host)
    assert is_this_machine(host)


@each_case("host", OTHERS)
def test_other_machines_are_other_hosts(host: str) -> None:
    assert not is_loopback(host)
    assert not is_this_machine(host)


@each_case("host", ["0.0.0.0", "::"])
def test_all_addresses_are_this_machine_but_others_reach_them(host: str) -> None:
    assert is_this_machine(host)
    assert not is_loopback(host)
