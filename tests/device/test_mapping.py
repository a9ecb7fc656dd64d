"""The four tables: values that are set and read, references to them, and their memory."""

import gc
import subprocess
import sys
import weakref
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Device, Mapping
from tests.support.cases import each_case

BITS = ["coils", "discrete_inputs"]
REGISTERS = ["holding_registers", "input_registers"]
TABLES = BITS + REGISTERS

each_table = each_case("name", TABLES)
each_bit_table = pytest.mark.parametrize("name", BITS)
each_register_table = pytest.mark.parametrize("name", REGISTERS)


def table(name: str, addresses: int | range) -> Any:
    """One table of a mapping of which nothing else is kept."""
    return getattr(Mapping(**{name: addresses}), name)


class TestArguments:
    @each_table
    @each_case(
        ("given_addresses", "addresses"),
        [
            (0, range(0)),
            (1, range(1)),
            (65536, range(65536)),
            (range(100, 200), range(100, 200)),
            (range(65535, 65536), range(65535, 65536)),
            (range(65536), range(65536)),
            (range(7, 7), range(7, 7)),
        ],
    )
    def test_a_count_or_a_range_sets_the_addresses(self, name: str, given_addresses, addresses):
        cells = table(name, given_addresses)
        assert cells.addresses == addresses
        assert cells.name == name
        assert len(cells) == len(addresses)
        assert cells[:] == [0] * len(addresses)

    def test_the_four_tables_are_separate(self) -> None:
        mapping = Mapping(8, 8, 8, 8)
        for value, name in enumerate(TABLES):
            getattr(mapping, name)[:] = [value > 1 and value] * 8
        mapping.coils[0] = True
        assert mapping.coils[:] == [True] + [False] * 7
        assert mapping.discrete_inputs[:] == [False] * 8
        assert mapping.holding_registers[:] == [2] * 8
        assert mapping.input_registers[:] == [3] * 8

    def test_repr_names_tables_and_ranges(self) -> None:
        mapping = Mapping(coils=8, holding_registers=range(100, 200))
        assert "coils 0..7" in repr(mapping)
        assert "holding_registers 100..199" in repr(mapping)
        assert "input_registers empty" in repr(mapping)


HOLES = [range(100, 110), range(120, 121), range(110, 112), range(300, 310)]


class TestHoles:
    @each_table
    def test_addresses_between_ranges_do_not_exist(self, name: str) -> None:
        cells = table(name, HOLES)
        assert cells.ranges == (range(100, 112), range(120, 121), range(300, 310))
        assert cells.addresses == range(100, 310)
        assert len(cells) == len(list(cells)) == 23
        assert repr(cells) == f"<{name} 100..111, 120..120, 300..309>"
        cells[300] = cells[120] = 1
        assert list(cells) == [0] * 12 + [1, 1] + [0] * 9
        assert cells[108:112] == [0] * 4
        for address in (99, 112, 119, 121, 299, 310, -1):
            assert not cells.has(address)
            with pytest.raises(IndexError, match=rf"no address {address} in <{name} 100\.\.111"):
                cells[address]
            with pytest.raises(IndexError, match=f"no address {address} in"):
                cells[address] = 1

    @each_table
    @each_case(
        ("key", "missing"),
        [
            (slice(100, 121), 112),
            (slice(112, 113), 112),
            (slice(115, 121), 115),
            (slice(120, 122), 121),
            (slice(None), 112),
            (slice(305, 311), "305:311"),
        ],
    )
    def test_a_slice_names_missing_addresses(self, name: str, key: slice, missing: object) -> None:
        cells = table(name, HOLES)
        with pytest.raises(IndexError, match=rf"no address(es)? {missing} in <{name} "):
            cells[key]
        with pytest.raises(IndexError, match=rf"no address(es)? {missing} in"):
            cells[key] = [1] * 21
        assert not any(cells.view)
        assert cells[115:115] == []

    def test_values_start_at_the_given_addresses(self) -> None:
        mapping = Mapping(
            coils={7: [True, False, True]},
            holding_registers={100: [555, 0, 100], 0: range(3), 65535: (1,), 5: []},
        )
        assert list(mapping.coils) == mapping.coils[7:10] == [True, False, True]
        assert mapping.holding_registers.ranges == (range(3), range(100, 103), range(65535, 65536))
        assert list(mapping.holding_registers) == [0, 1, 2, 555, 0, 100, 1]

    @each_table
    def test_a_repr_shows_few_ranges(self, name: str) -> None:
        for nothing in ([], {}, {5: []}, [range(5, 5)]):
            assert repr(table(name, nothing)) == f"<{name} empty>"
        cells = table(name, [range(at, at + 1) for at in range(0, 2000, 2)])
        assert repr(cells).endswith("14..14, 992 more>")
        assert len(cells) == 1000

    @each_table
    @each_case(
        ("bad", "error", "text"),
        [
            (-1, ValueError, "must be in"),
            (65537, ValueError, "must be in"),
            (range(65535, 65537), ValueError, "must be "),
            (range(-1, 5), ValueError, "must be "),
            (range(10, 0, -1), ValueError, "must be "),
            (1.0, TypeError, "must be "),
            ("8", TypeError, "must be "),
            (None, TypeError, "must be "),
            (True, TypeError, "must be "),
            (slice(0, 5), TypeError, "must be "),
            ([range(10), range(9, 12)], ValueError, r"9\.\.11 overlaps 0\.\.9"),
            ({0: [0, 1], 1: [1]}, ValueError, r"1\.\.1 overlaps 0\.\.1"),
            ([range(10), range(65530, 65537)], ValueError, r"within 0\.\.65535"),
            ([range(0, 10, 2)], ValueError, r"step 1"),
            ({65535: [1, 1]}, ValueError, r"within 0\.\.65535"),
            ({-1: [1]}, ValueError, r"an address must be in 0\.\.65535"),
            ({"0": [1]}, TypeError, "an address must be an integer"),
            ({7: 1}, TypeError, r"\[7\] must be a list of values, not int"),
            ({7: [1, "x"]}, TypeError, "a value is"),
            ([range(3), 5], TypeError, r"a count, ranges of addresses or {address: values}, not"),
        ],
    )
    def test_wrong_ranges_are_refused_with_the_table(self, name: str, bad, error, text) -> None:
        with pytest.raises(error, match=rf"^{name}.*{text}"):
            table(name, bad)

    def test_a_value_of_several_registers_does_not_cross_missing_addresses(self) -> None:
        registers = Mapping(holding_registers={0: [1, 2], 3: [4]}).holding_registers
        assert registers.read(0, "uint32") == 0x10002
        with pytest.raises(IndexError, match="no address 2 in"):
            registers.read(1, "uint32")
        with pytest.raises(IndexError, match="no address 2 in"):
            registers.write_values(0, [1, 2], "uint32")
        assert list(registers) == [1, 2, 4]


class TestAccess:
    @each_table
    def test_an_empty_table_has_no_address(self, name: str) -> None:
        cells = table(name, 0)
        assert list(cells) == cells[:] == cells[0:0] == []
        for key in (0, -1):
            with pytest.raises(IndexError, match=f"<{name} empty>"):
                cells[key]

    @each_table
    def test_slices_are_taken_by_address(self, name: str) -> None:
        cells = table(name, range(100, 110))
        cells[102:105] = [1, 0, 1]
        assert cells[:] == [0, 0, 1, 0, 1, 0, 0, 0, 0, 0]
        assert cells[100:103] == [0, 0, 1]
        assert cells[104:] == [1, 0, 0, 0, 0, 0]
        assert cells[:103] == [0, 0, 1]
        assert cells[100:110] == cells[:]
        assert cells[105:105] == cells[100:100] == cells[110:110] == []
        cells[103:103] = []
        assert cells[100:110:2] == [0, 1, 1, 0, 0]
        cells[100:110:3] = [1, 1, 0, 1]
        assert cells[:] == [1, 0, 1, 1, 1, 0, 0, 0, 0, 1]

    @each_table
    @each_case(
        "key",
        [
            slice(99, 105),
            slice(105, 111),
            slice(0, 5),
            slice(-3, None),
            slice(None, -1),
            slice(105, 104),
            slice(100, 110, 0),
            slice(100, 110, -1),
            slice(110, 100, -1),
            slice(111, None),
        ],
        ids=str,
    )
    def test_slices_beyond_the_table_are_errors(self, name: str, key: slice) -> None:
        cells = table(name, range(100, 110))
        with pytest.raises(IndexError, match=rf"<{name} 100\.\.109>"):
            cells[key]
        with pytest.raises(IndexError, match=rf"<{name} 100\.\.109>"):
            cells[key] = [0] * 10
        assert cells[:] == [0] * 10

    @each_table
    @each_case("key", [1.0, "1", None, (1, 2), slice(1.0, 2), slice("a", None)])
    def test_addresses_are_integers(self, name: str, key: Any) -> None:
        cells = table(name, 10)
        with pytest.raises(TypeError, match=f"address in <{name}"):
            cells[key]
        with pytest.raises(TypeError, match=f"address in <{name}"):
            cells[key] = 0

    @each_table
    @each_case("values", [[], [1], [1] * 3, [1] * 65537])
    def test_an_assignment_needs_as_many_values_as_addresses(self, name: str, values: list[int]):
        cells = table(name, 10)
        with pytest.raises(ValueError, match=f"{name}: {len(values)} values for 2 addresses"):
            cells[4:6] = values
        assert cells[:] == [0] * 10

    @each_table
    def test_bad_value_changes_nothing(self, name: str) -> None:
        cells = table(name, 4)
        for bad in (None, "1", 1.5, [1]):
            with pytest.raises(TypeError, match=f"^{name}: a value is "):
                cells[1] = bad
            with pytest.raises(TypeError, match=f"^{name}: a value is "):
                cells[0:3] = [1, 1, bad]
        with pytest.raises(TypeError):
            cells[0:3] = 5
        assert cells[:] == [0] * 4

    @each_register_table
    def test_registers_go_from_0_to_65535(self, name: str) -> None:
        cells = table(name, 4)
        cells[0:2] = [0, 65535]
        assert cells[0:2] == [0, 65535]
        assert [type(value) for value in cells] == [int] * 4
        for bad in (-1, 65536):
            with pytest.raises(ValueError, match=rf"^{name}: .* 0\.\.65535, not {bad}"):
                cells[0] = bad
            with pytest.raises(ValueError, match=rf"^{name}: .* 0\.\.65535, not {bad}"):
                cells[0:2] = [1, bad]
        assert cells[0:2] == [0, 65535]

    @each_bit_table
    @each_case("value", [0, 1, 2, 255, 256, 65536, -1, 1 << 70, True, False])
    def test_bits_become_0_or_1_whatever_integer_is_assigned(self, name: str, value: int) -> None:
        cells = table(name, 4)
        cells[1] = value
        cells[2:4] = [value, not value]
        assert cells[:] == [False, bool(value), bool(value), not value]
        assert {type(bit) for bit in cells} == {bool}
        assert list(cells.view) == [0, int(value != 0), int(value != 0), int(value == 0)]

    @settings(max_examples=40)
    @given(
        name=st.sampled_from(TABLES),
        first=st.integers(0, 65516),
        steps=st.lists(
            st.tuples(
                st.integers(0, 19), st.integers(1, 20), st.lists(st.integers(0, 65535), max_size=20)
            ),
            max_size=30,
        ),
    )
    def test_a_table_is_a_dict_of_its_addresses(
        self, name: str, first: int, steps: list[tuple[int, int, list[int]]]
    ) -> None:
        addresses = range(first, first + 20)
        cells, model = table(name, addresses), dict.fromkeys(addresses, 0)
        for offset, stride, values in steps:
            start = first + offset
            room = addresses[offset :: stride if len(values) != 1 else 1][: len(values)]
            if len(values) == 1:
                cells[start] = values[0]
            elif room:
                cells[start : room[-1] + 1 : stride] = values[: len(room)]
            for address, value in zip(room, values, strict=False):
                model[address] = int(value != 0) if name in BITS else value
            assert cells[start] == model[start]
            assert cells[start::stride] == [model[at] for at in addresses[offset::stride]]
        assert dict(zip(addresses, cells, strict=True)) == model


class TestTypedValues:
    @each_register_table
    def test_typed_values_are_written_as_known_registers(self, name: str) -> None:
        cells = table(name, range(100, 110))
        cells.write(100, 1.0, "float32", order="CDAB")
        cells.write(102, -2, "int32")
        cells.write(104, "AB", "string:4", padding=" ")
        cells.write(109, 1234, "bcd16")
        assert cells[:] == [0, 0x3F80, 0xFFFF, 0xFFFE, 0x4142, 0x2020, 0, 0, 0, 0x1234]
        assert cells.read(100, "float32", order="CDAB") == 1.0
        assert cells.read(102, "int32") == -2
        assert cells.read(104, "string:4", padding=" ") == "AB"
        assert cells.read(104, "string:4") == "AB  "
        assert cells.read(109, "bcd16") == 1234

    @each_register_table
    def test_lists_of_typed_values_are_written_and_read(self, name: str) -> None:
        cells = table(name, range(100, 106))
        cells.write_values(100, [1.0, 2.0], "float32", order="CDAB")
        assert cells[:] == [0, 0x3F80, 0, 0x4000, 0, 0]
        assert cells.read_values(100, "float32", 2, order="CDAB") == [1.0, 2.0]
        assert cells.read_values(102, "float32", count=2, order="CDAB") == [2.0, 0.0]
        assert cells.read_values(100, "float32", order="CDAB") == [1.0]
        cells.write_values(100, (text for text in ("A", "BC")), "string:2", padding=" ")
        assert cells.read_values(100, "string:2", 3, padding=" ") == ["A", "BC", ""]
        cells.write_values(106, [], "int16")

    @each_register_table
    @each_case("address", [-1, 0, 99, 109, 110, 65535, 1 << 70])
    def test_all_registers_of_a_value_exist(self, name: str, address: int) -> None:
        cells = table(name, range(100, 110))
        for access in (
            lambda: cells.write(address, 1.0, "float32"),
            lambda: cells.read(address, "float32"),
            lambda: cells.write_values(address, [1.0], "float32"),
            lambda: cells.read_values(address, "float32"),
        ):
            with pytest.raises(IndexError, match=rf"{address}:.* in <{name} 100\.\.109>"):
                access()
        assert cells[:] == [0] * 10

    @each_register_table
    @each_case(
        ("access", "error", "message"),
        [
            (lambda cells: cells.write(0, 70000, "uint16"), ValueError, "^value must be in 0"),
            (lambda cells: cells.write(0, "1", "uint16"), TypeError, "^value must be an integer"),
            (lambda cells: cells.write(0, 1, "uint12"), ValueError, "type must be one of"),
            (lambda cells: cells.write(0, 1, "int16", order="X"), ValueError, "order must be"),
            (lambda cells: cells.write("0", 1, "int16"), TypeError, "address in <.* an integer"),
            (lambda cells: cells.write(0, "ABC", "string:2"), ValueError, "value must have"),
            (lambda cells: cells.write_values(0, [1, -1], "uint16"), ValueError, r"^values\[1\]"),
            (lambda cells: cells.write_values(0, "AB", "string:2"), TypeError, "values must be"),
            (lambda cells: cells.read(9, "bcd16"), ValueError, r"registers\[0:1\] hold no bcd16"),
            (lambda cells: cells.read(0.0, "bcd16"), TypeError, "address in <.* an integer"),
            (lambda cells: cells.read(0, "bcd8"), ValueError, "type must be one of"),
            (lambda cells: cells.read(0, "int16", order="X"), ValueError, "order must be"),
            (lambda cells: cells.read_values(8, "bcd16", 2), ValueError, r"registers\[1:2\]"),
            (lambda cells: cells.read_values(0, "int16", 0), ValueError, r"count must be in 1\.\."),
            (lambda cells: cells.read_values(0, "int16", 65537), ValueError, "count must be in"),
            (lambda cells: cells.read_values(0, "int16", 1.0), TypeError, "count must be an"),
        ],
    )
    def test_refused_typed_values_change_nothing(self, name: str, access, error, message) -> None:
        cells = table(name, 10)
        cells[9] = 0xFFFF
        with pytest.raises(error, match=message):
            access(cells)
        assert cells[:] == [0] * 9 + [0xFFFF]


class TestViews:
    @each_table
    def test_a_view_begins_at_the_first_address(self, name: str) -> None:
        cells = table(name, range(100, 110))
        cells[101] = 1
        assert len(cells.view) == 10
        assert cells.view.tolist() == [0, 1, 0, 0, 0, 0, 0, 0, 0, 0]
        assert cells.view.format == ("B" if name in BITS else "H")
        assert cells.view.itemsize == (1 if name in BITS else 2)

    @each_register_table
    def test_register_view_writes_into_the_table(self, name: str) -> None:
        cells = table(name, range(10, 14))
        view = cells.view
        view[1] = 0x1234
        view[2:4] = memoryview(b"\1\0\2\0" if sys.byteorder == "little" else b"\0\1\0\2").cast("H")
        assert cells[:] == [0, 0x1234, 1, 2]

    @each_bit_table
    def test_bit_view_is_read_only(self, name: str) -> None:
        view = table(name, 4).view
        assert view.readonly
        with pytest.raises(TypeError):
            view[0] = 1

    def test_views_are_what_clients_read_and_write(self) -> None:
        mapping = Mapping(coils=8, holding_registers=8)
        coils, registers = mapping.coils.view, mapping.holding_registers.view
        device = Device(mapping)
        registers[3] = 0xBEEF
        assert device.answer(b"\x03\0\3\0\1") == b"\x03\x02\xbe\xef"
        device.answer(b"\x06\0\4\x12\x34")
        device.answer(b"\x0f\0\0\0\3\1\5")
        assert registers[4] == 0x1234
        assert coils.tolist() == [1, 0, 1, 0, 0, 0, 0, 0]

    @each_table
    def test_view_outlives_its_mapping(self, name: str) -> None:
        mapping = Mapping(**{name: 65536})
        getattr(mapping, name)[7] = 1
        view = getattr(mapping, name).view
        del mapping
        gc.collect()
        others = [table(name, 65536) for _ in range(5)]  # other tables would take the freed memory
        for other in others:
            other[:] = [1] * 65536
        assert view[7] == 1
        assert sum(view) == 1
        if name in REGISTERS:
            view[8] = 65535
            assert sum(view) == 65536


MEASURE = """
import os
from libmodbus_py import Device, Mapping

def resident():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

FULL = dict.fromkeys(("coils", "discrete_inputs", "holding_registers", "input_registers"), 65536)
Device(Mapping(**FULL)).answer(b"\\3\\0\\0\\0\\1")
before = resident()
mappings = [Mapping(**FULL) for _ in range(100)]
for mapping in mappings:
    mapping.holding_registers[40000] = 1
    assert Device(mapping).answer(b"\\3\\x9c\\x40\\0\\1") == b"\\3\\2\\0\\1"
sparse = resident() - before
before = resident()
for mapping in mappings[:50]:
    mapping.holding_registers.view[:] = memoryview(b"\\1\\0" * 65536).cast("H")
filled = resident() - before
before = resident()
HOLES = [range(at, at + 100) for at in range(0, 65000, 1000)]
others = [Mapping(*[HOLES] * 4) for _ in range(100)]
print(sparse, filled, resident() - before)
"""


def test_full_mapping_takes_memory_only_where_it_is_written() -> None:
    run = subprocess.run(
        [sys.executable, "-c", MEASURE], capture_output=True, text=True, check=True, timeout=50
    )
    sparse, filled, holes = map(int, run.stdout.split())
    assert max(sparse, holes) < 100 * 393_216 / 5
    assert filled > 50 * 131_072 * 0.9  # the measure itself sees what is written


CIRCLE = """
import gc
from libmodbus_py import Mapping

for name in ("coils", "holding_registers"):
    mapping = Mapping(8, 8, 8, 8)
    mapping.itself = mapping
    view, holder = getattr(mapping, name)._cells, [mapping]
    del mapping
    gc.collect()  # now the view comes before the mapping
    del view, holder
    gc.collect()
print("done")
"""


def test_a_mapping_in_a_reference_cycle_is_collected() -> None:
    """A memoryview that something else looks into must not be cleared first (gh-77894)."""
    run = subprocess.run([sys.executable, "-c", CIRCLE], capture_output=True, text=True, timeout=50)
    assert (run.stdout, run.stderr, run.returncode) == ("done\n", "", 0)


def test_mappings_without_references_are_freed() -> None:
    mapping = Mapping(coils=1)
    reference = weakref.ref(mapping)
    del mapping
    gc.collect()
    assert reference() is None
