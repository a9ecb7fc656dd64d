"""
Points of models: types, scale factors, repeats, and lengths that do not fit.
"""

from __future__ import annotations

import pytest
from sunspec2.device import get_model_def

from libmodbus_py import RegisterMap
from libmodbus_py.tools.sunspec.discovery import _discovery, definition_of, folder
from libmodbus_py.tools.sunspec.points import ModelLayout
from tests.support.sunspec import chain, walked

KNOWN = [int(path.stem.partition("_")[2]) for path in folder().glob("model_*.json")]


def test_every_definition_becomes_a_map() -> None:
    assert len(KNOWN) > 100
    for number in KNOWN:
        group = definition_of(number)
        assert group is not None
        laid = ModelLayout(group, 40002, 400, {}).laid()
        assert len(RegisterMap(laid.points)) > 2, number
        first = [point.name for point in laid.points[:2]]
        assert first == ["ID", "L"], number
        assert group["name"] == get_model_def(number)["group"]["name"]


def test_model_160_has_as_many_modules_as_its_length_has() -> None:
    fixed = [0xFFFF, 0, 0xFFFF, 3, 0, 0, 2, 0xFFFF]
    module = [1, *([0] * 8), 500, 4000, 0x8000, 0, 77, 0, 0, 25, 4, 0, 2]
    cells = chain([160, 48, *fixed, *module, 2, *module[1:]])
    found = walked(_discovery(None, [40000]), cells)
    points = found.result[160].map
    assert found.result.notes == ()
    assert [points[f"module.{at}.ID"].address for at in (1, 2)] == [40012, 40032]
    assert "module.3.ID" not in points
    assert len(found.requests) == 3


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
    found = walked(_discovery(None, [40000]), chain([160, length, *([0] * length)])).result
    assert found.notes == (f"model 160 at address 40002 has the length {length}: {note}",)
    assert found.end == 40004 + length
    assert all(point.cells.stop <= 40004 + length for point in found[160].map.values())


def test_registers_beyond_the_definition_are_noted() -> None:
    found = walked(_discovery(None, [40000]), chain([1, 70, *([0] * 70)])).result
    assert found.notes == ("model 1 at address 40002 has 4 registers more than its definition",)


def test_a_common_model_without_its_padding_is_no_mistake() -> None:
    found = walked(_discovery(None, [40000]), chain([1, 65, *([0] * 65)])).result
    assert found.notes == ()
    assert list(found[1].map) == ["ID", "L", "Mn", "Md", "Opt", "Vr", "SN", "DA"]


@pytest.mark.parametrize("count", [65535, 60000])
def test_a_count_that_does_not_fit_makes_no_storm(count: int) -> None:
    # 705: NPt and NCrv are the registers 5 and 6 of the model.
    model = [705, 20, 0, 0, 0, count, count, *([0] * 15)]
    found = walked(_discovery(None, [40000]), chain(model))
    assert len(found.requests) == 4
    assert len(found.result[705].map) < 30


def test_no_more_points_are_made_than_there_is_room_for() -> None:
    group = definition_of(160)
    assert group is not None
    laid = ModelLayout(group, 40002, 25000, {}, room=40).laid()
    assert len(laid.points) == 40
    assert laid.notes[-1] == "there are too many points: module.4.IDStr is left out"


def test_values_are_scaled_named_and_missing() -> None:
    cells = chain([101, 50, 123, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE, *([0x8000] * 45)])
    points = walked(_discovery(None, [40000]), cells).result[101].map
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
    point = walked(_discovery(None, [40000]), chain([11, 13, *[0] * 13])).result[11].map["MAC"]
    registers = [0, 0x0DD7, 0x4CC6, 0x448E]
    assert point.decode(registers) == "0D:D7:4C:C6:44:8E"
    assert point.encode("0D:D7:4C:C6:44:8E") == registers
    assert point.decode([7, 0xFFFF, 0xFFFF, 0xFFFF]) is None
