"""Who answers where: real pseudo-terminals and sockets, and peers of every kind."""

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, ModbusConnectionError, Server
from libmodbus_py.scan import FoundUnit, Scan, scan, search
from tests.simulation.network import Network
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.golden import Refused
from tests.support.interop import UNIT, program
from tests.support.peers import FakeServer, mbap, mute_port, refusing, url_of
from tests.support.pymodbus_peers import pymodbus_serving
from tests.tools.scan.simulated_bus import Member, SimulatedBus, answering, line, of, served

QUICK = 0.05  # seconds for the answer of a missing unit
PATIENT = 1.0  # seconds for the answer of a unit, on a busy machine

READING = {1, 2, 3, 4, 17, 43}

OBJECTS = {"VendorName": "ACME", "ProductCode": "M1", "MajorMinorRevision": "1.2"}


def meter(**tables: Any) -> Device:
    return Device(Mapping(**tables), identification=OBJECTS)


def at(unit: FoundUnit) -> tuple[int, int | None, str | None, int | None]:
    return unit.unit, unit.baudrate, unit.parity, unit.stop_bits


def all_of(scanned: Scan) -> list[FoundUnit]:
    with scanned:
        return list(scanned)


def only_read(pdus: list[bytes]) -> bool:
    """No function that writes, and of 8 and 43 none that changes anything."""
    return all(row[0] in READING and (row[0] != 43 or row[1] == 14) for row in pdus)


def three_units() -> dict[int, Member]:
    return {
        5: Member(of(meter(holding_registers=10)), 9600, 2),
        17: Member(of(meter(coils=8)), 19200, 1),
        42: Member(of(meter(holding_registers=1)), 9600, 2),
    }


@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
def test_three_units_are_found_at_their_two_rates(network: Network, scheme: str) -> None:
    bus = SimulatedBus(network, three_units(), scheme)
    scanned = scan(bus.url, baudrates=[9600, 19200], parities="EN", units=[5, 6, 17, 42])
    assert bus.asked == []
    assert scanned.total == 16
    units = all_of(scanned)
    assert [at(unit) for unit in units] == [
        (5, 9600, "N", 2),
        (42, 9600, "N", 2),
        (17, 19200, "E", 1),
    ]
    assert [unit.exception for unit in units] == [None, None, 2]
    for unit in units:
        assert unit.data_bits == (7 if scheme == "ascii" else 8)
        assert unit.server_id is not None
        assert unit.server_id.running
        assert unit.identification is not None
        assert unit.identification.names == OBJECTS
        assert (unit.is_late, unit.is_any) == (False, False)
        assert unit.took < 0.2  # the first answer on a line is held for longer
    assert only_read([request[2] for request in bus.asked])
    assert scanned.requests == len(bus.asked)
    with Client(units[0].url) as client:  # the URL can be used by a client
        assert client.read_holding_registers(0, 10) == [0] * 10


def test_a_late_answer_is_that_of_its_own_unit_and_not_of_the_next(network: Network) -> None:
    members = {7: Member(of(meter(holding_registers=1)), 9600, 2, after=0.3)}
    bus = SimulatedBus(network, members)
    scanned = scan(bus.url, baudrates=[9600], parities=["N"], units=[7, 8, 9, 10], timeout=0.2)
    (unit,) = all_of(scanned)
    assert (unit.unit, unit.is_late, unit.exception) == (7, True, None)
    # As each unit found is, though its answers come too late, too.
    assert {request[2][0] for request in bus.asked if request[1] == 7} == {3, 17, 43}
    # And the frames of eight and seven characters, of eleven bits each.
    assert unit.took == pytest.approx(0.3 + 15 * 11 / 9600, abs=0.001)
    assert any("came late" in note for note in scanned.notes)


def test_a_late_answer_over_tcp_is_that_of_its_own_unit(network: Network) -> None:
    """Through a gateway that works off what it was asked, one after the other."""
    answers: list[bytes] = []

    def slow(request: bytes) -> list[bytes]:
        answers.append(mbap(request, b"\x03\x02\0\1" if request[6] == 2 else b"\x83\x0b"))
        return [answers.pop(0)] if len(answers) > 2 else []  # each comes two requests later

    server = served(network, "tcp://10.0.0.1", slow)
    scanned = scan(server.url, units=[1, 2, 3, 4, 5], timeout=0.1)
    assert [(unit.unit, unit.is_late) for unit in all_of(scanned)] == [(2, True)]
    assert server.connections == 1


@pytest.mark.parametrize(
    ("answers", "note"),
    [
        (
            [lambda request: [b"\x00\xff\x13"], lambda request: [b"\x83"], lambda _: [b"\x07" * 9]],
            "",
        ),
        ([lambda request: [request]], "echo=True?"),
    ],
)
def test_noise_and_an_echo_are_not_taken_for_a_unit(network: Network, answers, note) -> None:
    unit = served(network, "rtu:///dev/line", *answers)
    url = f"{unit.url}?baudrate=115200&parity=N"
    scanned = scan(url, units=range(1, 7), timeout=QUICK)
    assert all_of(scanned) == []
    assert len(unit.requests) == 6
    (message,) = scanned.notes
    assert note in message


def test_a_line_that_is_never_silent_is_scanned_in_time(network: Network) -> None:
    bus = SimulatedBus(network, {})
    bus.flood(b"\x55", 0.0012)
    scanned = scan(bus.url, baudrates=[9600], parities=["N"], timeout=0.1)
    started = network.events.now
    assert all_of(scanned) == []
    assert len({request[1] for request in bus.asked}) == 247
    assert network.events.now - started < 2 * scanned.longest
    assert "or others send" in scanned.notes[0]


def test_a_port_that_disappears_ends_the_scan_with_the_units_found() -> None:
    with line({1: meter()}) as wire:
        scanned = scan(f"rtu://{wire.client}", baudrates=[9600], parities="N", timeout=PATIENT)
        assert next(scanned).unit == 1
        wire.unplug()
        with pytest.raises(ModbusConnectionError):
            next(scanned)
        with pytest.raises(StopIteration):
            next(scanned)
    assert scanned.requests < 10


def test_a_baudrate_that_the_port_refuses_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pseudo-terminals take any rate: the answer of the kernel is made up."""
    from libmodbus_py.ports import serial

    def refuse(descriptor: int, baudrate: int) -> None:
        raise OSError(22, f"baudrate {baudrate} refused")

    monkeypatch.setattr(serial, "set_odd_baudrate", refuse)
    with line({1: meter()}) as wire:
        url = f"rtu://{wire.client}"
        scanned = scan(url, baudrates=[12345, 9600], parities="N", units=[1], timeout=PATIENT)
        assert [at(unit) for unit in all_of(scanned)] == [(1, 9600, "N", 2)]
        assert "12345" in scanned.notes[0]
        with pytest.raises(ModbusConnectionError, match="refused"):
            next(scan(url, baudrates=[12345], units=[1]))


SCHEMES = ["tcp", "udp", "rtu+tcp", "ascii+tcp"]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_units_are_found_over_networks(network: Network, scheme: str) -> None:
    units = {1: meter(holding_registers=1), 17: meter()}
    peer = answering(network, f"{scheme}://10.0.0.1", units)
    devices = all_of(scan(peer.url, units=[1, 2, 17, 18]))
    assert [(device.unit, device.exception, device.baudrate) for device in devices] == [
        (1, None, None),
        (17, 2, None),
    ]
    assert all(device.identification is not None for device in devices)


@pytest.mark.parametrize(
    ("scheme", "tables"), [("tcp", {"coils": 1}), ("rtu+tcp", {"holding_registers": 1})]
)
def test_a_server_that_ignores_the_unit_is_one_device(scheme: str, tables: Any) -> None:
    with FakeServer(lambda request: [mbap(request, b"\x03\x02\0\1", unit=255)]) as server:
        (device,) = all_of(scan(server.url, timeout=PATIENT))  # unit 255 in all answers
        assert device.is_any
    with Server(meter(**tables)).background(f"{scheme}://127.0.0.1:0") as running:
        scanned = scan(running.urls[0], timeout=PATIENT)
        (device,) = all_of(scanned)
        assert device.is_any
        assert device.identification is not None
    assert ["ignores the unit" in note for note in scanned.notes] == [True]


def test_units_that_answer_like_missing_ones_are_not_counted() -> None:
    """A gateway that answers exception 4 for whoever is not there, as mbusd does for some."""

    def answer(request: bytes) -> list[bytes]:
        return [mbap(request, b"\x03\x02\0\1" if request[6] == 17 else b"\x83\x04")]

    with FakeServer(answer) as server:
        scanned = scan(server.url, timeout=PATIENT)
        assert [unit.unit for unit in all_of(scanned)] == [17]
    assert any("247 units are answered like units that cannot exist" in n for n in scanned.notes)


def test_a_server_that_closes_connections_for_unknown_units_is_scanned_on(network: Network) -> None:
    """It ends each connection with the first question to anybody else."""

    def answer(request: bytes) -> list[Any]:
        if request[6] != 4:
            return [None]
        refusal = bytes([request[7] | 0x80, 1])
        return [mbap(request, b"\x03\x02\0\1" if request[7] == 3 else refusal)]

    server = served(network, "tcp://10.0.0.1", answer)
    assert [unit.unit for unit in all_of(scan(server.url, units=[3, 4, 5]))] == [4]
    assert server.connections > 1


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_a_unit_without_an_answer_does_not_end_the_connection(network: Network, scheme: str):
    """Some devices take one at a time, and late answers come over the one that was asked."""
    server = served(network, f"{scheme}://10.0.0.1", lambda request: [])
    scanned = scan(server.url, units=range(1, 9), timeout=QUICK)
    assert all_of(scanned) == []
    assert server.connections == 1


@pytest.mark.parametrize("begin", [scan, search])
def test_an_unreachable_host_is_reported_soon(begin: Callable[..., Any]) -> None:
    with mute_port() as port, pytest.raises(ModbusConnectionError):
        next(begin(f"tcp://127.0.0.1:{port}", timeout=0.1))
    with refusing() as bound:
        for url in (url_of(bound), url_of(bound).replace("tcp", "udp")):
            with pytest.raises(ModbusConnectionError):
                next(begin(url))
    with pytest.raises(ModbusConnectionError, match="cannot open"):
        next(begin("rtu:///dev/nowhere"))


def test_a_server_of_libmodbus_over_tcp_is_found_as_one_device(compiled: Callable[[str], Path]):
    """Its server does not look at the unit."""
    with program(compiled("server"), "tcp", 0) as process:
        (device,) = all_of(scan(f"tcp://127.0.0.1:{_port(process)}", timeout=PATIENT))
        assert (device.unit, device.is_any, device.exception) == (1, True, 2)
        assert device.server_id is not None
        assert device.server_id.identifier == b"\xb4"
        assert device.identification is None


@pytest.mark.parametrize("scheme", ["tcp", "rtu"])
def test_a_server_of_pymodbus_is_found(scheme: str) -> None:
    options: Any = {} if scheme == "tcp" else {"parities": "E"}
    with pymodbus_serving(scheme) as url:
        units = all_of(scan(url, units=[UNIT - 1, UNIT], timeout=0.5, **options))
    assert [(unit.unit, unit.is_any) for unit in units] == [(UNIT, False)]


def _port(process: subprocess.Popen[str]) -> int:
    assert process.stdout is not None
    word, port = process.stdout.readline().split()
    assert word == "ready"
    return int(port)


def test_a_scan_can_be_stopped_at_any_time() -> None:
    with line({number: meter() for number in (1, 2, 3)}) as wire:
        url = f"rtu://{wire.client}"
        for unit in scan(url, baudrates=[9600], parities="N", timeout=PATIENT):
            assert unit.unit == 1
            break
        del unit
    with line({1: meter()}) as wire:
        scanned = scan(f"rtu://{wire.client}", baudrates=[9600], parities="N", timeout=PATIENT)
        next(scanned)
        scanned.close()
        scanned.close()
        assert list(scanned) == []


def test_a_scan_can_be_closed_from_a_signal_handler() -> None:
    with line({}) as wire:
        scanned = scan(f"rtu://{wire.client}", baudrates=[9600], parities="N", timeout=60)
        before = signal.signal(signal.SIGALRM, lambda *_: scanned.close())
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.2)
            assert list(scanned) == []
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


def test_an_exception_of_the_callback_ends_the_scan_and_closes_it() -> None:
    def fail(progress: object) -> None:
        raise KeyboardInterrupt

    with line({}) as wire:
        scanned = scan(f"rtu://{wire.client}", on_progress=fail)
        with pytest.raises(KeyboardInterrupt):
            next(scanned)
    assert scanned.requests == 0


def test_wrong_arguments_are_refused_before_anything_is_sent(refused: Refused) -> None:
    refused("refused.txt", lambda arguments: scan(arguments[0], **arguments[1]))
    refused("search_refused.txt", lambda arguments: search(arguments[0], **arguments[1]))


def test_units_are_found_over_tls(tmp_path: Path) -> None:
    pki = Pki(tmp_path)
    server = Server({1: meter(), 9: meter()}, security=pki.server())
    stranger = pki.security(certificates.self_signed())
    with server.background("tls://127.0.0.1:0") as running:
        url = running.urls[0]
        assert [unit.unit for unit in all_of(scan(url, security=pki.client()))] == [1, 9]
        with pytest.raises(ModbusConnectionError):  # at once, not 248 times
            next(scan(url, security=stranger, timeout=PATIENT))
        assert server.statistics.accepted < 9


def test_an_endless_identification_ends_after_four_pages(network: Network) -> None:
    pages: list[int] = []

    def answer(request: bytes) -> list[bytes]:
        if request[7] != 43:
            return [mbap(request, bytes([request[7] | 0x80, 11 if request[6] > 200 else 1]))]
        pages.append(at := request[10])
        page = bytes([43, 14, request[9], 2, 0xFF, at + 1, 1, at, 1, 0x41])
        return [mbap(request, page)]

    server = served(network, "tcp://10.0.0.1", answer)
    (unit,) = all_of(scan(server.url, units=[5], timeout=PATIENT))
    assert pages == [0, 1, 2, 3]
    assert unit.identification is not None
    assert unit.identification.objects == dict.fromkeys(range(4), b"A")
    assert not unit.identification.complete
