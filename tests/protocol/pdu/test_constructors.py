"""What the constructors of requests refuse, and how they name it."""

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from libmodbus_py import pdu
from tests.protocol.pdu.examples import EXAMPLES
from tests.support.cases import each_case
from tests.support.golden import Refused


class Seven:
    """An integer that is not an int, as those of numpy are."""

    def __index__(self) -> int:
        return 7


# Makes a request with this argument; and with an address before it.
Make = Callable[[Any], pdu.Request[Any]]
MakeAt = Callable[[int, Any], pdu.Request[Any]]

NO_INTEGERS: list[Any] = [1.5, "1", None, True, b"1", [1]]
NO_SEQUENCES: list[Any] = ["12", b"12", bytearray(b"12"), {1: 2}, {1, 2}, frozenset({1}), 5, None]

# Constructors with one address, and what makes the rest of their arguments.
ADDRESSED: list[tuple[str, Make]] = [
    ("address", lambda address: pdu.ReadCoils(address, 1)),
    ("address", lambda address: pdu.ReadDiscreteInputs(address, 1)),
    ("address", lambda address: pdu.ReadHoldingRegisters(address, 1)),
    ("address", lambda address: pdu.ReadInputRegisters(address, 1)),
    ("address", lambda address: pdu.WriteCoil(address, True)),
    ("address", lambda address: pdu.WriteRegister(address, 1)),
    ("address", lambda address: pdu.WriteCoils(address, [True])),
    ("address", lambda address: pdu.WriteRegisters(address, [1])),
    ("address", lambda address: pdu.MaskWriteRegister(address, 0, 0)),
    ("address", pdu.ReadFifoQueue),
    ("read_address", lambda address: pdu.ReadWriteRegisters(address, 1, 0, [1])),
    ("write_address", lambda address: pdu.ReadWriteRegisters(0, 1, address, [1])),
]

COUNTED: list[tuple[str, int, MakeAt]] = [
    ("count", 2000, pdu.ReadCoils),
    ("count", 2000, pdu.ReadDiscreteInputs),
    ("count", 125, pdu.ReadHoldingRegisters),
    ("count", 125, pdu.ReadInputRegisters),
    ("read_count", 125, lambda address, count: pdu.ReadWriteRegisters(address, count, 0, [1])),
]

SEQUENCED: list[tuple[str, int, MakeAt]] = [
    ("values", 1968, pdu.WriteCoils),
    ("values", 123, pdu.WriteRegisters),
    ("values", 121, lambda address, values: pdu.ReadWriteRegisters(0, 1, address, values)),
]

# All numbers: name, range, and what makes the rest.
NUMBERS: list[tuple[str, int, int, Make]] = [
    ("sub_function", 0, 65535, pdu.Diagnostics),
    ("code", 1, 4, pdu.ReadDeviceIdentification),
    ("object_id", 0, 255, lambda number: pdu.ReadDeviceIdentification(4, number)),
    ("mei_type", 0, 255, lambda number: pdu.EncapsulatedTransport(number, b"")),
    ("function", 1, 127, pdu.RawRequest),
    *((name, 0, 65535, make) for name, make in ADDRESSED),
    *((name, 1, limit, partial(make, 0)) for name, limit, make in COUNTED),
]

# Constructors with bytes: how many there may be.
BYTES: list[tuple[list[int], list[int], Make]] = [
    ([2, 4, 248, 250], [0, 1, 3, 249, 251, 252], lambda data: pdu.Diagnostics(0, data)),
    ([2], [0, 1, 3, 4, 250], lambda data: pdu.Diagnostics(1, data)),
    ([2], [0, 1, 3, 4, 250], lambda data: pdu.Diagnostics(0xFFFF, data)),
    ([0, 1, 250, 251], [252, 1000], lambda data: pdu.EncapsulatedTransport(13, data)),
    ([0, 1, 251, 252], [253, 1000], lambda data: pdu.RawRequest(65, data)),
]

REGISTERS: list[tuple[str, Make]] = [
    ("value", lambda value: pdu.WriteRegister(0, value)),
    ("and_mask", lambda value: pdu.MaskWriteRegister(0, value, 0)),
    ("or_mask", lambda value: pdu.MaskWriteRegister(0, 0, value)),
    (r"values\[2\]", lambda value: pdu.WriteRegisters(0, [1, 2, value])),
    (r"values\[2\]", lambda value: pdu.ReadWriteRegisters(0, 1, 0, [1, 2, value])),
    (r"records\[0\] values\[1\]", lambda value: pdu.WriteFileRecords([(1, 0, [1, value])])),
]


class TestConstructors:
    @each_case(("name", "low", "high", "make"), NUMBERS)
    def test_numbers_have_their_ranges(self, name: str, low: int, high: int, make: Make) -> None:
        for good in (low, high):
            assert getattr(make(good), name) == good
        for bad in (low - 1, high + 1, -1, 1 << 40):
            with pytest.raises(ValueError, match=rf"^{name} must be in {low}\.\.{high}, not {bad}"):
                make(bad)
        for wrong in NO_INTEGERS:
            with pytest.raises(TypeError, match=rf"^{name} must be an integer in {low}\.\.{high}"):
                make(wrong)

    @each_case(("name", "low", "high", "make"), NUMBERS)
    def test_numbers_of_other_types_become_int(self, name, low, high, make) -> None:
        if high >= 7:
            number = getattr(make(Seven()), name)
            assert number == 7
            assert type(number) is int

    @each_case(("good", "bad", "make"), BYTES)
    def test_data_are_bytes_of_some_sizes(self, good, bad, make) -> None:
        for size in good:
            assert len(make(bytes(size)).encode()) <= pdu.MAX_PDU
        for size in bad:
            with pytest.raises(ValueError, match=rf"^data must be .*, not {size}$"):
                make(bytes(size))
        for wrong in ("ab", [1, 2], (1, 2), None, 2, bytearray(2), memoryview(b"ab")):
            with pytest.raises(TypeError, match=r"^data must be bytes, not "):
                make(wrong)

    def test_diagnostics_have_a_zero_word_by_default(self) -> None:
        assert pdu.Diagnostics(pdu.SubFunction.CLEAR_COUNTERS) == pdu.Diagnostics(10, b"\0\0")
        assert pdu.Diagnostics(10).encode() == b"\x08\0\x0a\0\0"

    def test_only_force_listen_only_expects_no_answer(self) -> None:
        silent = [number for number in range(65536) if not pdu.Diagnostics(number).expects_response]
        assert silent == [pdu.SubFunction.FORCE_LISTEN_ONLY]
        assert all(request.expects_response for request in EXAMPLES)

    @each_case(("name", "limit", "make"), COUNTED)
    def test_address_and_count_do_not_pass_65536(self, name: str, limit: int, make: MakeAt) -> None:
        make(65535, 1)
        make(65536 - limit, limit)
        for address, count in ((65535, 2), (65536 - limit + 1, limit)):
            with pytest.raises(ValueError, match=rf"address \+ {name} .* 65536"):
                make(address, count)

    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_values_hold_1_to_their_limit(self, name: str, limit: int, make: MakeAt) -> None:
        for good in (1, limit):
            assert len(getattr(make(0, [1] * good), name)) == good
        for bad in ([], [1] * (limit + 1), itertools.repeat(1)):
            with pytest.raises(ValueError, match=rf"^{name} must hold 1\.\.{limit} values"):
                make(0, bad)

    @each_case("bad", NO_SEQUENCES, ids=repr)
    @each_case(("name", "limit", "make"), SEQUENCED)
    def test_text_sets_mappings_and_numbers_are_no_values(self, name, limit, make, bad) -> None:
        with pytest.raises(TypeError, match=rf"^{name} must be a sequence of 1\.\.{limit} values"):
            make(0, bad)

    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_values_of_any_iterable_are_kept_as_a_tuple(self, name, limit, make) -> None:
        for values in ([1, 0], (1, 0), range(1, -1, -1), (value for value in (1, 0))):
            field = getattr(make(0, values), name)
            assert field == (1, 0)
            assert type(field) is tuple

    def test_registers_of_other_kinds_of_integers_become_int(self) -> None:
        assert repr(pdu.WriteRegisters(0, [1, Seven()]).values) == "(1, 7)"

    @pytest.mark.parametrize(("name", "limit", "make"), SEQUENCED)
    def test_address_and_values_do_not_pass_65536(self, name, limit, make) -> None:
        make(65536 - limit, [1] * limit)
        with pytest.raises(ValueError, match=rf"address \+ len\({name}\) .* 65536"):
            make(65536 - limit + 1, [1] * limit)

    @each_case(("name", "make"), REGISTERS)
    def test_registers_go_from_0_to_65535(self, name: str, make: Make) -> None:
        make(0)
        make(65535)
        for bad in (-1, 65536):
            with pytest.raises(ValueError, match=rf"^{name} must be in 0\.\.65535, not {bad}"):
                make(bad)
        for bad in NO_INTEGERS:
            with pytest.raises(TypeError, match=rf"^{name} must be an integer in 0\.\.65535"):
                make(bad)

    @pytest.mark.parametrize(
        ("name", "make"),
        [
            ("value", lambda value: pdu.WriteCoil(0, value)),
            (r"values\[1\]", lambda value: pdu.WriteCoils(0, [True, value])),
        ],
    )
    def test_coils_are_true_false_1_or_0(self, name: str, make: Make) -> None:
        assert make(1) == make(True)
        assert make(0) == make(False)
        assert make(0) != make(1)
        for bad in (2, -1, 0xFF00):
            with pytest.raises(ValueError, match=rf"^{name} must be in 0\.\.1, not {bad}"):
                make(bad)
        for bad in (1.0, "1", None, b"\1"):
            with pytest.raises(TypeError, match=rf"^{name} must be an integer in 0\.\.1"):
                make(bad)

    def test_read_file_records_names_the_bad_piece(self, refused: Refused) -> None:
        refused(
            "wrong_reads_of_records.txt", lambda record: pdu.ReadFileRecords([(1, 0, 1), record])
        )

    def test_write_file_records_names_the_bad_piece(self, refused: Refused) -> None:
        refused(
            "wrong_writes_of_records.txt",
            lambda record: pdu.WriteFileRecords([(1, 0, [1]), record]),
        )

    @pytest.mark.parametrize("kind", [pdu.ReadFileRecords, pdu.WriteFileRecords])
    def test_records_are_a_sequence_of_at_least_one(self, kind: Any) -> None:
        with pytest.raises(ValueError, match=r"^records must hold 1"):
            kind([])
        for bad in NO_SEQUENCES:
            with pytest.raises(TypeError, match=r"^records must be a sequence"):
                kind(bad)

    def test_file_pieces_must_fit_into_one_message(self) -> None:
        """Section 6.14 and 6.15: what the PDU of 253 bytes holds, to the last register."""
        pdu.ReadFileRecords([(1, 0, 124)])
        pdu.ReadFileRecords([(1, 0, 1)] * 35)
        pdu.ReadFileRecords([(1, 0, 61)] * 2)  # 2 * (2 + 122) = 248
        with pytest.raises(ValueError, match=r"^records ask for a response of 252 bytes"):
            pdu.ReadFileRecords([(1, 0, 62)] * 2)
        with pytest.raises(ValueError, match=r"^records must hold 1\.\.35"):
            pdu.ReadFileRecords([(1, 0, 1)] * 36)
        assert len(pdu.WriteFileRecords([(1, 0, [1] * 122)]).encode()) == 253
        pdu.WriteFileRecords([(1, 0, [1])] * 27)
        with pytest.raises(ValueError, match=r"^records take 252 bytes, more than 251"):
            pdu.WriteFileRecords([(1, 0, [1] * 59), (2, 0, [1] * 60)])
        with pytest.raises(ValueError, match=r"^records must hold 1\.\.27"):
            pdu.WriteFileRecords([(1, 0, [1])] * 28)

    def test_requests_are_equal_by_value_and_hashable(self) -> None:
        request = pdu.WriteRegisters(1, [1, 2])
        assert request == pdu.WriteRegisters(1, (1, 2))
        assert hash(request) == hash(pdu.WriteRegisters(1, (1, 2)))
        assert request != pdu.WriteRegisters(1, [1, 3])
        assert pdu.ReadCoils(0, 1) != pdu.ReadDiscreteInputs(0, 1)
        with pytest.raises(AttributeError):
            request.address = 2  # type: ignore[misc]

    def test_a_list_passed_to_a_request_is_copied(self) -> None:
        values = [1, 2]
        request = pdu.WriteRegisters(1, values)
        values.append(3)
        assert request.values == (1, 2)

    def test_the_repr_names_the_arguments_and_stays_short(self) -> None:
        assert str(pdu.ReadCoils(3, 5)) == "ReadCoils(address=3, count=5)"
        assert len(str(pdu.WriteCoils(0, [True] * 1968))) < 200
        assert len(str(pdu.WriteFileRecords([(1, 0, [1])] * 27))) < 300

    def test_only_requests_that_change_the_device_alone_can_be_broadcast(self) -> None:
        writes = {code for code, request in pdu.REQUESTS.items() if request.may_be_broadcast}
        assert writes == {5, 6, 15, 16, 21, 22}
        assert all(pdu.REQUESTS[code].changes for code in writes)
        assert not any(
            kind.may_be_broadcast for kind in (pdu.ReadDeviceIdentification, pdu.RawRequest)
        )
