"""Transactions that a listener hears, with the names of their values."""

from libmodbus_py import Point, RegisterMap
from libmodbus_py.listen import MapDecoder, Separator, Transaction
from libmodbus_py.tools.listener.named import LearnedMap
from tests.support.cases import each_case
from tests.support.driver import rtu

POINTS = RegisterMap(
    [
        Point("voltage", "holding_registers", 107, type="uint16", scale=0.1, units="V"),
        Point("energy", "holding_registers", 108, type="uint32"),
        Point("power", "input_registers", 8, type="int16", scale_from="exponent"),
        Point("exponent", "input_registers", 9, type="int16", missing=-32768),
        Point("valve", "coils", 172),
        Point("secret", "holding_registers", 4, access="write"),
    ]
)


def pairs_of(*pairs: tuple[str, str]) -> list[Transaction]:
    """Return transactions of unit 17 on a line: requests, and responses, empty for none."""
    separator, transactions, at = Separator("rtu"), list[Transaction](), 0.0
    for pair in pairs:
        for text in filter(None, pair):
            at += 0.1
            transactions += separator.feed(rtu(f"11 {text}"), at)
        at += 10
    return transactions + separator.end()


READ_3 = ("03 006B 0003", "03 06 08FD 0001 0002")  # 2301; 65538
READ_107 = ("03 006B 0001", "03 02 08FD")
READ_108 = ("03 006C 0001", "03 02 0001")
READ_109 = ("03 006D 0001", "03 02 0002")
POWER = ("04 0008 0001", "04 02 000A")
EXPONENT = ("04 0009 0001", "04 02 0002")
BOTH = ("04 0008 0002", "04 04 000A 0002")
NONE = ("04 0008 0002", "04 04 000A 8000")
COIL = ("05 00AC FF00", "05 00AC FF00")
MASK = ("16 0004 00F2 0025", "16 0004 00F2 0025")
WRITE_4 = ("06 0004 0012", "06 0004 0012")
READ_4 = ("03 0004 0001", "03 02 0012")
REFUSED = ("06 006B 0001", "86 02")
UNANSWERED = ("06 006B 0001", "")

WRITTEN = ("valve", "secret")


@each_case(
    ("pairs", "values"),
    [
        ([READ_3], [("voltage", 230.1), ("energy", 65538)]),
        ([READ_108, READ_109], [("energy", 65538)]),
        ([READ_109, READ_107], [("voltage", 230.1)]),
        ([BOTH], [("power", 1000), ("exponent", 2)]),
        ([EXPONENT, POWER], [("exponent", 2), ("power", 1000)]),
        ([POWER], [("power", None)]),
        ([NONE], [("power", None), ("exponent", None)]),
        ([COIL], [("valve", True)]),
        ([WRITE_4, MASK], [("secret", 0x12), ("secret", 0x17)]),
        ([MASK], []),
        ([READ_4], []),
        ([REFUSED], []),
        ([UNANSWERED], []),
    ],
)
def test_transactions_have_the_values_of_a_map(pairs, values) -> None:
    decoder = MapDecoder(POINTS)
    decodings = [entry for transaction in pairs_of(*pairs) for entry in decoder.decode(transaction)]
    assert [(decoding.name, decoding.value) for decoding in decodings] == values
    assert {decoding.unit for decoding in decodings} <= {17}
    assert all(decoding.reason == "" for decoding in decodings if decoding.value is not None)
    assert [item.is_written for item in decodings] == [item.name in WRITTEN for item in decodings]


def test_cells_of_each_unit_are_separate() -> None:
    decoder, separator = MapDecoder(POINTS), Separator("rtu")
    values = []
    for at, text in enumerate(
        ("11 03 006C 0001", "11 03 02 0001", "12 03 006D 0001", "12 03020002")
    ):
        for frame in separator.feed(rtu(text), at * 0.1):
            values += decoder.decode(frame)
    assert values == []


def test_a_map_is_derived_from_requests() -> None:
    learned = LearnedMap()
    again = ("03 006B 0003", "03 06 08FE 0001 0002")
    for entry in pairs_of(READ_3, again, REFUSED, COIL, MASK, ("04 0010 0001", "84 02")):
        learned.add_transaction(entry)
    points = {point.name: point for point in learned.points()}
    assert {name: (point.access, point.description) for name, point in points.items()} == {
        "unit_17_coils_172": ("write", "1"),
        "unit_17_holding_registers_4": ("write", "no value heard"),
        "unit_17_holding_registers_107": ("read_write", "2301..2302"),
        "unit_17_holding_registers_108": ("read", "1"),
        "unit_17_holding_registers_109": ("read", "2"),
        "unit_17_input_registers_16": ("read", "no value heard"),
    }
    assert {point.group for point in points.values()} == {"unit 17"}


def test_a_broadcast_has_only_the_values_that_it_writes() -> None:
    decoder, learned, separator = MapDecoder(POINTS), LearnedMap(), Separator("rtu")
    values = []
    transactions = separator.feed(rtu("00 03 006B 0003"), 0.0)  # a mistake of the master
    transactions += separator.feed(rtu("00 06 006B 0001"), 5.0)
    for entry in transactions + separator.end():
        values += decoder.decode(entry)
        learned.add_transaction(entry)
    assert [(value.unit, value.name, value.value, value.is_written) for value in values] == [
        (0, "voltage", 0.1, True)
    ]
    assert [point.description for point in learned.points()] == ["1", *["no value heard"] * 2]
