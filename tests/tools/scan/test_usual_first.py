"""The order of a full scan of a line: usual settings and units first."""

import pytest

from libmodbus_py import Device, Mapping
from libmodbus_py.scan import scan
from libmodbus_py.tools.scan.probe import FIRST_UNITS, USUAL_UNITS
from libmodbus_py.tools.scan.scan import Progress
from tests.simulation.network import Network
from tests.tools.scan.simulated_bus import Member, SimulatedBus, of

TIMEOUT = 0.05

SETTINGS = 24
FIRST = SETTINGS * len(FIRST_UNITS)


def device() -> Device:
    return Device(Mapping(holding_registers=1))


def probed(bus: SimulatedBus) -> list[tuple[int, int]]:
    """Return (baudrate, unit) of each probe, without identification."""
    return [(baudrate, unit) for baudrate, unit, pdu in bus.asked if pdu == b"\x03\0\0\0\1"]


def test_usual_settings_and_units_are_asked_first(network: Network) -> None:
    bus = SimulatedBus(network, {})
    steps: list[Progress] = []
    with scan(bus.url, timeout=TIMEOUT, on_progress=steps.append) as scanned:
        assert list(scanned) == []
    places = list(dict.fromkeys(step.setting for step in steps))
    assert places[:4] == ["9600 8E1", "9600 8N2", "19200 8E1", "19200 8N2"]
    assert places[4:9] == ["9600 8O1", "19200 8O1", "38400 8E1", "38400 8N2", "38400 8O1"]
    rates = list(dict.fromkeys(place.partition(" ")[0] for place in places[6:]))
    assert rates == ["38400", "57600", "115200", "4800", "2400", "1200"]
    assert len(places) == SETTINGS == scanned.settings
    usual = SETTINGS * len(USUAL_UNITS)
    assert [step.unit for step in steps[:FIRST]] == [*FIRST_UNITS] * SETTINGS
    assert {step.unit for step in steps[:usual]} == {*USUAL_UNITS}
    assert {step.unit for step in steps[usual:]} == {*range(1, 248)} - {*USUAL_UNITS}
    settings = {(step.setting, step.unit) for step in steps}
    assert len(settings) == len(steps) == scanned.total == SETTINGS * 247  # each once
    assert [step.done for step in steps] == [*range(scanned.total)]
    assert {setting: sorted(units) for setting, units in scanned.tried.items()} == {
        place: [*range(1, 248)] for place in places
    }


@pytest.mark.parametrize(
    ("baudrate", "stop_bits", "most"),
    [(9600, 1, 2), (9600, 2, 5), (19200, 2, 10), (38400, 1, 20), (115200, 2, 40), (1200, 1, 80)],
)
def test_a_device_with_factory_settings_is_found_soon(network: Network, baudrate, stop_bits, most):
    bus = SimulatedBus(network, {1: Member(of(device()), baudrate, stop_bits)})
    started = network.events.now
    with scan(bus.url) as scanned:
        answer = next(scanned)
    assert (answer.unit, answer.baudrate, answer.stop_bits) == (1, baudrate, stop_bits)
    assert network.events.now - started < most
    assert {unit for units in scanned.tried.values() for unit in units} <= {*FIRST_UNITS}


def test_settings_with_an_answer_come_first_in_the_second_round(network: Network):
    members = {7: Member(of(device()), 19200, 1), 55: Member(of(device()), 19200, 1)}
    bus = SimulatedBus(network, members)
    steps: list[Progress] = []
    scanned = scan(bus.url, timeout=TIMEOUT, on_progress=steps.append)
    unit = next(scanned)
    assert (unit.unit, unit.baudrate, unit.parity) == (7, 19200, "E")
    assert len(steps) < FIRST + 3 * len(USUAL_UNITS)
    late = [(unit.unit, unit.baudrate, unit.parity) for unit in scanned]
    second = steps[SETTINGS * len(USUAL_UNITS)]
    assert (second.setting, second.unit) == ("19200 8E1", 11)
    # One stop bit: odd parity looks the same on this bus.
    assert late == [(7, 19200, "O"), (55, 19200, "E"), (55, 19200, "O")]


def test_a_scan_knows_before_it_starts_how_long_each_part_takes(network: Network) -> None:
    bus = SimulatedBus(network, {})
    scanned = scan(bus.url, timeout=TIMEOUT)
    started = network.events.now
    ends: list[float] = []

    def note(progress: Progress) -> None:
        if progress.done == FIRST:
            ends.append(network.events.now - started)

    scanned = scan(bus.url, timeout=TIMEOUT, on_progress=note)
    list(scanned)
    assert bus.asked
    assert 0.6 * scanned.longest_first < ends[0] < scanned.longest_first
    assert ends[0] < network.events.now - started < scanned.longest


def test_given_units_are_asked_in_one_round_in_their_order(network: Network) -> None:
    bus = SimulatedBus(network, {})
    scanned = scan(bus.url, baudrates=[19200, 9600], parities="E", units=[40, 1], timeout=0.05)
    list(scanned)
    assert probed(bus) == [(19200, 40), (19200, 1), (9600, 40), (9600, 1)]
    assert scanned.longest_first == scanned.longest


def test_a_device_that_answers_all_units_is_not_asked_again(network: Network) -> None:
    every = {unit: Member(of(device()), 9600, 2) for unit in range(256)}
    bus = SimulatedBus(network, every)
    with scan(bus.url, baudrates=[9600, 19200], parities="N", timeout=TIMEOUT) as scanned:
        units = list(scanned)
    assert [(unit.is_any, unit.baudrate) for unit in units] == [(True, 9600)]
    assert len([unit for baudrate, unit in probed(bus) if baudrate == 9600]) == 3
    assert sum("all units are answered alike" in note for note in scanned.notes) == 1
