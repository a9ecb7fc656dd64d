"""Discovery over TCP, beside pysunspec2's client: the same models, registers and values."""

import asyncio
import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from sunspec2.device import get_model_def
from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP

from libmodbus_py import AsyncClient, Client, RegisterMap, sunspec
from libmodbus_py.sunspec import SunSpecError
from libmodbus_py.tools.sunspec import BASES, ModelLayout, _discovery, definition_of, folder, walk
from tests.support.sunspec import chain, file_device, serving, walk_through

DEVICES = {"inverter_123.json": 2, "device_1547.json": 14}
"""File of pysunspec2 -> the number of its models."""

FoundUnit = tuple[sunspec.SunSpecDevice, dict[str, Any]]


def blocking(url: str) -> FoundUnit:
    with Client(url) as plc:
        device = sunspec.discover(plc)
        return device, plc.read_map(device.map)


def awaiting(url: str) -> FoundUnit:
    async def ask() -> FoundUnit:
        async with AsyncClient(url) as plc:
            device = await sunspec.discover(plc)
            return device, await plc.read_map(device.map)

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
            for at, entry in enumerate(inner, 1):
                yield from values_of(entry, f"{prefix}{name}.{at}.")
        else:
            yield from values_of(inner, f"{prefix}{name}.")


def comparable(ours: Any, kind: str, theirs: Any, point: Any) -> tuple[Any, Any]:
    """Return both values in one form: numbers for states and bits."""
    symbols = {row["name"]: row["value"] for row in point.pdef.get("symbols") or ()}
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
    name, ask: Callable[[str], FoundUnit]
) -> None:
    with serving(file_device(name)) as url:
        device, values = ask(url)
        host, _, port = url.removeprefix("tcp://").rpartition(":")
        peer = SunSpecModbusClientDeviceTCP(1, host, int(port), timeout=5)
        peer.scan()
        peer.close()
    assert [(model.id, model.address, model.length) for model in device] == [
        (entry.model_id, entry.model_addr, entry.model_len) for entry in peer.model_list
    ]
    assert (len(device), device.notes) == (DEVICES[name], ())
    compared = 0
    for model, theirs in zip(device, peer.model_list, strict=True):
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
def test_an_unknown_model_is_kept_as_registers(ask: Callable[[str], FoundUnit]) -> None:
    with serving(chain([64999, 3, 7, 8, 9], [64999, 0])) as url:
        device, values = ask(url)
    assert [model.is_known for model in device] == [False, False]
    assert values["model_64999.registers"] == [7, 8, 9]
    assert values["model_64999_2.L"] == 0


def test_a_device_without_models_is_refused() -> None:
    with serving([1, 2, 3]) as url, Client(url) as plc:
        with pytest.raises(sunspec.SunSpecError, match="address 40000: no SunS there"):
            sunspec.discover(plc)
        assert plc.statistics.requests == 3


def test_models_and_names_are_found_in_the_device() -> None:
    with serving(file_device("device_1547.json")) as url, Client(url) as plc:
        device = sunspec.discover(plc, bases=[40000])
        # The marker, 14 models, the end model; 705 to 712 say how often groups repeat.
        assert plc.statistics.requests == 1 + 14 + 1 + 8
    assert device[701] is device["DERMeasureAC"]
    assert isinstance(device.map, RegisterMap)
    with pytest.raises(KeyError):
        device[103]


@pytest.mark.parametrize(
    ("bases", "error"), [([], ValueError), ([65535], ValueError), ("0", TypeError), (7, TypeError)]
)
def test_wrong_bases_are_refused(bases: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="bases"):
        sunspec.discover(Client("tcp://127.0.0.1:9"), bases=bases)


def test_an_object_that_is_no_client_is_refused() -> None:
    with pytest.raises(TypeError, match="client must be a client, not str"):
        sunspec.discover("tcp://127.0.0.1")  # type: ignore[call-overload]


def test_without_pysunspec2_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("libmodbus_py.tools.sunspec.find_spec", lambda name: None)
    assert importlib.util.find_spec("sunspec2")
    with pytest.raises(ImportError, match=r"SunSpec needs pysunspec2: .* 'pysunspec2>="):
        sunspec.discover(Client("tcp://127.0.0.1:9"))


COMMON = [1, 66, *([0] * 66)]


def test_a_chain_is_followed_to_the_end_model() -> None:
    walk_result = walk_through(walk(BASES), chain(COMMON, [64999, 3, 7, 8, 9]))
    result = walk_result.result
    assert [tuple(header) for header in result.headers] == [(1, 40002, 66), (64999, 40070, 3)]
    assert (result.base, result.end, result.notes) == (40000, 40075, [])
    assert walk_result.requests == [(0, 2), (40000, 2), (40002, 2), (40070, 2), (40075, 2)]


LAST = 65536 - 40004


@pytest.mark.parametrize(
    ("cells", "models", "requests", "note"),
    [
        # An exception in place of a header, the end of the table, models without an end, zeros.
        (chain(COMMON, end=[]), 1, 4, "the chain has no end model: address 40070: "),
        (chain([101, LAST, *[0] * LAST], end=[]), 1, 3, "the chain has no end model before"),
        (chain(*[[7, 0]] * 5000), 256, 258, "the chain has more than 256 models; the rest is"),
        (chain(COMMON, end=[0] * 5000), 1, 4, "the chain has no end model: there is no model 0,"),
        (chain(COMMON, [101, 65535]), 1, 4, "model 101 at address 40070 is left out: its length,"),
    ],
)
def test_a_chain_without_an_end_model_is_read_as_far_as_it_is_valid(
    cells: list[int], models: int, requests: int, note: str
) -> None:
    walk_result = walk_through(walk(BASES), cells)
    assert (len(walk_result.result.headers), len(walk_result.requests)) == (models, requests)
    assert walk_result.result.end is None
    assert [entry[: len(note)] for entry in walk_result.result.notes] == [note]


@pytest.mark.parametrize("base", BASES)
def test_the_marker_is_searched_for_at_each_base(base: int) -> None:
    walk_result = walk_through(walk(BASES), chain(COMMON), base)
    assert (walk_result.result.base, walk_result.result.notes) == (base, [])
    with pytest.raises(SunSpecError, match=r"address 0: .* address 40000: .* address 50000: "):
        walk_through(walk(BASES), [0] * 10, 0)


KNOWN = [int(path.stem.partition("_")[2]) for path in folder().glob("model_*.json")]


def test_every_definition_becomes_a_map() -> None:
    assert len(KNOWN) > 100
    for number in KNOWN:
        group = definition_of(number)
        assert group is not None
        laid = ModelLayout(group, 40002, 400, {})
        assert len(RegisterMap(laid.points)) > 2, number
        first = [point.name for point in laid.points[:2]]
        assert first == ["ID", "L"], number
        assert group["name"] == get_model_def(number)["group"]["name"]


def test_model_160_has_as_many_modules_as_its_length_says() -> None:
    fixed = [0xFFFF, 0, 0xFFFF, 3, 0, 0, 2, 0xFFFF]
    module = [1, *([0] * 8), 500, 4000, 0x8000, 0, 77, 0, 0, 25, 4, 0, 2]
    cells = chain([160, 48, *fixed, *module, 2, *module[1:]])
    device = walk_through(_discovery([40000]), cells)
    points = device.result[160].map
    assert device.result.notes == ()
    assert [points[f"module.{at}.ID"].address for at in (1, 2)] == [40012, 40032]
    assert "module.3.ID" not in points
    assert len(device.requests) == 3


@pytest.mark.parametrize(
    ("length", "note"),
    [
        (9, "module takes 20 registers each, and 1 is not a multiple"),
        (47, "module takes 20 registers each, and 39 is not a multiple"),
        (5, "Evt and what follows do not fit"),
        (0, "DCA_SF and what follows do not fit"),
    ],
)
def test_a_length_that_fits_no_whole_group_is_noted(length: int, note: str) -> None:
    device = walk_through(_discovery([40000]), chain([160, length, *([0] * length)])).result
    assert device.notes == (f"model 160 at address 40002 has the length {length}: {note}",)
    assert device.end == 40004 + length
    assert all(point.cells.stop <= 40004 + length for point in device[160].map.values())


@pytest.mark.parametrize("count", [65535, 60000])
def test_a_count_that_does_not_match_the_length_causes_few_requests(count: int) -> None:
    # 705: NPt and NCrv are the registers 5 and 6 of the model.
    model = [705, 20, 0, 0, 0, count, count, *([0] * 15)]
    device = walk_through(_discovery([40000]), chain(model))
    assert len(device.requests) == 4
    assert len(device.result[705].map) < 30


def test_the_number_of_points_is_limited() -> None:
    group = definition_of(160)
    assert group is not None
    laid = ModelLayout(group, 40002, 25000, {}, room=40)
    assert len(laid.points) == 40
    assert laid.notes[-1] == "there are too many points: module.4.IDStr is left out"


def test_values_are_scaled_and_named_and_may_be_missing() -> None:
    cells = chain([101, 50, 123, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE, *([0x8000] * 45)])
    points = walk_through(_discovery([40000]), cells).result[101].map
    assert points["A"].scale_from == "A_SF"
    assert points["A"].decode([123], source=-2) == 1.23
    assert points["A"].decode([0xFFFF], source=-2) is None
    assert points["W"].decode([0x8000], source=0) is None
    assert points["WH"].decode([0, 0], source=0) is None
    assert points["St"].decode([4]) == "MPPT"
    assert points["St"].decode([0xFFFF]) is None
    assert points["St"].decode([99]) == 99
    assert points["Evt1"].decode([0, 1])["GROUND_FAULT"] is True
    assert points["Evt1"].decode([0xFFFF, 0xFFFF]) is None
    assert points["A"].units == "A"
    assert points["A"].access == "read"


def test_a_mac_address_is_text_when_read_and_written() -> None:
    point = walk_through(_discovery([40000]), chain([11, 13, *[0] * 13])).result[11].map["MAC"]
    registers = [0, 0x0DD7, 0x4CC6, 0x448E]
    assert point.decode(registers) == "0D:D7:4C:C6:44:8E"
    assert point.encode("0D:D7:4C:C6:44:8E") == registers
    assert point.decode([0xABCD, 0, 0, 1]) == "00:00:00:00:00:01"  # the padding may be anything
    assert point.decode([7, 0xFFFF, 0xFFFF, 0xFFFF]) is None
