"""Registers and values of published manuals, and what their types hold."""

from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py.protocol.values import TYPES, WIDE_ORDERS, value_type
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.values import words

NOON = datetime(2026, 7, 1, 12, 30, 15, tzinfo=UTC)  # a Wednesday

# Type, order, registers and value. Where a manual has a form and no example, the registers are
# written by hand as it says.
MANUALS: list[tuple[str, str, str, Any]] = [
    # GE EPM 9650/9800, types F46 to F49: the high and the low byte of a register.
    ("int8", "BADC", "FBFF", -5),
    ("uint8", "BADC", "FF00", 255),
    ("int8", "ABCD", "FFFB", -5),
    ("uint8", "ABCD", "00FF", 255),
    # Alstom iSTAT i4MC, types T5 and T6: an exponent in front of 24 bits.
    ("uint24", "ABCD", "0001 E240", 123456),
    ("int24", "ABCD", "FFFE 1DC0", -123456),
    # Eaton PXR trip units, energy in registers 0 to 2, the lowest first.
    ("uint48", "CDAB", "9ABC 5678 1234", 0x123456789ABC),
    ("int48", "EFCDAB", "FFFE FFFF FFFF", -2),
    # Schneider Electric FA146443, energy of a PM800 in registers 1700 to 1703.
    ("umod10k64", "CDAB", "11D7 007B 0000 0000", 1234567),
    ("mod10k64", "CDAB", "11D7 007B 0000 0000", 1234567),
    # Schneider Electric FA212766: each register from -9999 to 9999.
    ("mod10k48", "CDAB", "E9D2 FB2E 0000", -12345678),
    ("umod10k48", "CDAB", "270F 270F 270F", 999_999_999_999),
    # EcoStruxure Power Monitoring Expert: S32-M10k-4321, U32-M10k-4321 and -2143.
    ("mod10k32", "ABCD", "FF85 EE29", -1234567),
    ("umod10k32", "ABCD", "007B 11D7", 1234567),
    ("umod10k32", "CDAB", "11D7 007B", 1234567),
    # Siemens, Programming with STEP 7, section 27.3.2.4: the four highest bits are the sign.
    ("sbcd16", "ABCD", "F413", -413),
    ("sbcd16", "ABCD", "0999", 999),
    ("sbcd32", "ABCD", "F999 9999", -9_999_999),
    ("sbcd32", "ABCD", "0000 0320", 320),
    # A sign in front of the amount, as in the mantissa of IEEE 754.
    ("signmag16", "ABCD", "8065", -101),
    ("signmag16", "ABCD", "0065", 101),
    ("signmag16", "ABCD", "0000", 0),
    ("signmag32", "CDAB", "0001 8000", -1),
    # AVEVA MBTCP driver: the registers of 64 bits in the orders 1 to 4; then with bytes swapped.
    ("uint64", "ABCDEFGH", "0123 4567 89AB CDEF", 0x0123456789ABCDEF),
    ("uint64", "CDABGHEF", "4567 0123 CDEF 89AB", 0x0123456789ABCDEF),
    ("uint64", "EFGHABCD", "89AB CDEF 0123 4567", 0x0123456789ABCDEF),
    ("uint64", "GHEFCDAB", "CDEF 89AB 4567 0123", 0x0123456789ABCDEF),
    ("uint64", "BADCFEHG", "2301 6745 AB89 EFCD", 0x0123456789ABCDEF),
    ("uint64", "HGFEDCBA", "EFCD AB89 6745 2301", 0x0123456789ABCDEF),
    ("uint64", "dcbahgfe", "6745 2301 EFCD AB89", 0x0123456789ABCDEF),
    ("uint64", "FEHGBADC", "AB89 EFCD 2301 6745", 0x0123456789ABCDEF),
    ("float64", "EFGHABCD", "0000 0000 4055 4800", 85.125),
    # Algodue UPM309, its clock in registers 204A and 204B.
    ("unix32", "ABCD", "522E 5FD4", datetime(2013, 9, 9, 23, 55, tzinfo=UTC)),
    # Engineered Concepts ETC: seconds since January 1, 2000.
    ("y2k32", "ABCD", "31D7 C4D7", NOON),
    # EPEver, real time clock in 9013 to 9015: minute and second, day and hour, year and month.
    ("date48", "CDAB", "1E0F 010C 1A07", NOON),
    # As real time clocks count, in decimal digits: second and minute, hour and day, month and year.
    ("bcddate48", "DCBA", "1530 1201 0726", NOON),
    # Socomec Masterys UPS, clock from 00CB on: ... month and day of the week, year less 2000.
    ("date64", "CDAB", "1E0F 010C 0703 001A", NOON),
    # Growatt, registers 45 to 50: "Year offset is 2000".
    ("shortdate96", "ABCD", "001A 0007 0001 000C 001E 000F", NOON),
]  # fmt: skip


@each_case(("name", "order", "registers", "value"), MANUALS)
def test_examples_of_manuals_encode_and_decode(name: str, order: str, registers: str, value: Any):
    kind = value_type(name, order=order)
    assert kind.decode(words(registers)) == value
    assert kind.encode(value) == words(registers)


# Other registers that hold the same: what is ignored, and spellings of signs.
OTHERS = [
    ("uint8", "ABCD", "12FF", 255),
    ("int8", "BADC", "FB00", -5),
    ("uint24", "ABCD", "FD01 E240", 123456),
    ("int24", "ABCD", "FDFE 1DC0", -123456),
    ("sbcd16", "ABCD", "8413", -413),
    ("signmag16", "ABCD", "8000", 0),
    ("date64", "ABCD", "001A 0700 010C 1E0F", NOON),
    # Siemens SICAM: the clock of iec870 from its end, without the day of the week.
    ("iec870", "CDAB", "3A98 0C1E 0701 001A", NOON),
]


@each_case(("name", "order", "registers", "value"), OTHERS)
def test_several_encodings_decode_to_the_same_value(name, order, registers, value) -> None:
    assert value_type(name, order=order).decode(words(registers)) == value


def test_registers_without_a_valid_value_are_refused(refused: Refused) -> None:
    refused("no_values.txt", lambda case: value_type(case[0]).decode(words(case[1])))


LIMITS = [
    ("int8", -128, 127),
    ("uint24", 0, 16_777_215),
    ("int48", -140_737_488_355_328, 140_737_488_355_327),
    ("signmag16", -32767, 32767),
    ("sbcd32", -9_999_999, 9_999_999),
    ("mod10k32", -327_679_999, 327_679_999),
    ("umod10k32", 0, 655_359_999),
    ("umod10k64", 0, 65_535_999_999_999_999),
]


@each_case(("name", "low", "high"), LIMITS)
def test_integers_beyond_limits_of_their_type_are_refused(name: str, low: int, high: int) -> None:
    kind = value_type(name)
    assert kind.limits == (low, high)
    for beyond in (low - 1, high + 1):
        with pytest.raises(ValueError, match=rf"^value must be in {low}\.\.{high}, not {beyond}$"):
            kind.encode(beyond)


INTEGERS = [name for name, kind in TYPES.items() if kind.limits and "float" not in name]


@given(st.data(), st.sampled_from(INTEGERS))
def test_every_integer_decodes_to_what_was_encoded(data: st.DataObject, name: str) -> None:
    low, high = map(int, value_type(name).limits or (0, 0))
    orders = ["ABCD", "CDAB", "BADC", "DCBA"]
    orders += WIDE_ORDERS if value_type(name).registers == 4 else ()
    kind = value_type(name, order=data.draw(st.sampled_from(orders)))
    value = data.draw(st.integers(low, high))
    assert kind.decode(kind.encode(value)) == value


@each_case(
    ("name", "order"),
    [(name, order) for name in ("uint32", "int48", "string:8", "date96") for order in WIDE_ORDERS],
)
def test_orders_for_64_bits_are_refused_for_other_widths(name: str, order: str) -> None:
    with pytest.raises(ValueError, match=f"order of {name} must be one of ABCD, CDAB, BADC, DCBA"):
        value_type(name, order=order)
