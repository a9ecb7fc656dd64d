"""
Discovery over TCP, beside pysunspec2's client: the same models, registers and values.
"""

from __future__ import annotations

import asyncio
import importlib.util
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP

from libmodbus_py import AsyncClient, Client, Device, Mapping, RegisterMap, Server, sunspec
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.sunspec import chain, file_device, serving

DEVICES = {"inverter_123.json": 2, "device_1547.json": 14}
"""File of pysunspec2 -> the number of its models."""

Found = tuple[sunspec.SunSpecDevice, dict[str, Any]]


def blocking(url: str) -> Found:
    with Client(url) as plc:
        found = sunspec.discover(plc)
        return found, plc.read_map(found.map)


def awaiting(url: str) -> Found:
    async def ask() -> Found:
        async with AsyncClient(url) as plc:
            found = await sunspec.discover(plc)
            return found, await plc.read_map(found.map)

    return asyncio.run(ask())


BOTH = pytest.mark.parametrize("ask", [blocking, awaiting])


def values_of(group: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the points of pysunspec2's client, by the names that they have here."""
    for name, point in group.points.items():
        kind = point.pdef["type"]
        if kind != "pad":
            value = point.cvalue if isinstance(point.pdef.get("sf"), str | int) else point.value
            yield prefix + name, (kind, value, point)
    for name, inner in group.groups.items():
        if isinstance(inner, list):
            for at, each in enumerate(inner, 1):
                yield from values_of(each, f"{prefix}{name}.{at}.")
        else:
            yield from values_of(inner, f"{prefix}{name}.")


def comparable(ours: Any, kind: str, theirs: Any, point: Any) -> tuple[Any, Any]:
    """Return both values in one form: numbers for states and bits."""
    symbols = {each["name"]: each["value"] for each in point.pdef.get("symbols") or ()}
    if isinstance(ours, dict):
        mask = sum(1 << at for at in symbols.values())
        theirs = None if theirs is None else theirs & mask
        return sum(bool(on) << symbols[name] for name, on in ours.items()), theirs
    if isinstance(ours, list):
        return sum(bit << at for at, bit in enumerate(ours)), theirs
    if isinstance(ours, str) and kind.startswith("enum"):
        return symbols[ours], theirs
    if kind == "string":
        return ours or "", theirs or ""
    if kind.startswith("acc"):
        return ours or 0, theirs or 0
    return ours, theirs


@BOTH
@pytest.mark.parametrize("name", DEVICES)
def test_the_models_and_values_are_those_of_pysunspec2(
    name: str, ask: Callable[[str], Found]
) -> None:
    with serving(file_device(name)) as url:
        found, values = ask(url)
        host, _, port = url.removeprefix("tcp://").rpartition(":")
        peer = SunSpecModbusClientDeviceTCP(1, host, int(port), timeout=5)
        peer.scan()
        peer.close()
    assert [(each.id, each.address, each.length) for each in found] == [
        (each.model_id, each.model_addr, each.model_len) for each in peer.model_list
    ]
    assert (len(found), found.notes) == (DEVICES[name], ())
    compared = 0
    for model, theirs in zip(found, peer.model_list, strict=True):
        for point, (kind, value, their_point) in values_of(theirs):
            ours = values[f"{model.name}.{point}"]
            if (source := model.map[point].scale_from) and values[f"{model.name}.{source}"] is None:
                assert ours is None  # theirs is not scaled
                continue
            pair = comparable(ours, kind, value, their_point)
            assert pair[0] == pytest.approx(pair[1]), (model.id, point)
            compared += 1
    assert compared > 0.7 * len(values)


@BOTH
def test_an_unknown_model_is_kept_as_registers(ask: Callable[[str], Found]) -> None:
    with serving(chain([64999, 3, 7, 8, 9], [64999, 0])) as url:
        found, values = ask(url)
    assert [each.is_known for each in found] == [False, False]
    assert values["model_64999.registers"] == [7, 8, 9]
    assert values["model_64999_2.L"] == 0


def test_a_device_without_models_is_refused() -> None:
    with serving([1, 2, 3]) as url, Client(url) as plc:
        with pytest.raises(sunspec.SunSpecError, match="address 40000: no SunS there"):
            sunspec.discover(plc)
        assert plc.statistics.requests == 3


def test_models_and_names_are_found_in_the_device() -> None:
    with serving(file_device("device_1547.json")) as url, Client(url) as plc:
        found = sunspec.discover(plc, bases=[40000])
        # The marker, 14 models, the end model; 705 to 712 say how often groups repeat.
        assert plc.statistics.requests == 1 + 14 + 1 + 8
    assert found[701] is found["DERMeasureAC"]
    assert isinstance(found.map, RegisterMap)
    with pytest.raises(KeyError):
        found[103]


@pytest.mark.parametrize(
    ("bases", "error"), [([], ValueError), ([65535], ValueError), ("0", TypeError), (7, TypeError)]
)
def test_wrong_bases_are_refused(bases: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="bases"):
        sunspec.discover(Client("tcp://127.0.0.1:9"), bases=bases)


def test_what_is_no_client_is_refused() -> None:
    with pytest.raises(TypeError, match="client must be a client, not str"):
        sunspec.discover("tcp://127.0.0.1")  # type: ignore[call-overload]


def test_without_pysunspec2_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("libmodbus_py.tools.sunspec.discovery.find_spec", lambda name: None)
    assert importlib.util.find_spec("sunspec2")
    with pytest.raises(ImportError, match=r"SunSpec needs pysunspec2: .* 'pysunspec2>="):
        sunspec.discover(Client("tcp://127.0.0.1:9"))


@pytest.mark.parametrize("scheme", ["udp", "rtu+tcp", "rtu+udp", "ascii+tcp", "rtu"])
def test_models_are_found_on_other_transports(scheme: str) -> None:
    device = Device(Mapping(holding_registers={40000: file_device("device_1547.json")}))
    with ExitStack() as stack:
        wire = stack.enter_context(SerialWire())
        at = f"rtu://{wire.server}" if scheme == "rtu" else f"{scheme}://127.0.0.1:0"
        running = stack.enter_context(Server({5: device}).background(at))
        url = f"rtu://{wire.client}" if scheme == "rtu" else running.urls[0]
        plc = stack.enter_context(Client(url, unit=5))
        found = sunspec.discover(plc)
        values = plc.read_map(found.map)
    assert len(found) == DEVICES["device_1547.json"]
    assert values["common.Mn"] == "SunSpecTest"
