"""Poll plans: against a table of cells, against the fewest requests, on every transport."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import (
    Client,
    IllegalDataAddress,
    InvalidResponse,
    ModbusTimeoutError,
    NoValue,
    Point,
    RegisterMap,
    pdu,
    values,
)
from libmodbus_py.maps.items import Read
from libmodbus_py.maps.plan import Plan, planned
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.peers import FakeServer, mbap

UNIT = 17
REGISTERS = {
    pdu.ReadHoldingRegisters: "holding_registers",
    pdu.ReadInputRegisters: "input_registers",
}
BITS = {pdu.ReadCoils: "coils", pdu.ReadDiscreteInputs: "discrete_inputs"}
TABLES = {**BITS, **REGISTERS}


def cell(table: str, address: int) -> Any:
    """Every register holds its address, and has two bytes of ASCII."""
    return bool(address % 3) if table in BITS.values() else (address % 100) << 8 | address // 100


def spans(plan: Plan) -> list[tuple[str, range]]:
    return [
        (TABLES[type(item)], range(item.address, item.address + item.count))  # type: ignore[attr-defined,index]
        for item in plan.requests
    ]


def answers(plan: Plan) -> list[list[Any]]:
    return [[cell(table, address) for address in cells] for table, cells in spans(plan)]


C, H, INPUT = "coils", "holding_registers", "input_registers"

# Items, options, and the requests: table, first address and count.
REQUESTS: list[tuple[list[Any], dict[str, Any], list[tuple[str, int, int]]]] = [
    ([(C, 5)], {}, [(C, 5, 1)]),
    ([(C, 5, 3), (C, 8, 2)], {}, [(C, 5, 5)]),
    ([(C, 8, 2), (C, 5, 4)], {}, [(C, 5, 5)]),
    ([(C, 5, 3), (C, 9, 2)], {}, [(C, 5, 3), (C, 9, 2)]),
    ([(C, 5, 3), (C, 9, 2)], {"gap": 1}, [(C, 5, 6)]),
    ([(C, 5, 3), (C, 9, 2)], {"gap": 9, "forbidden": [(C, range(8, 9))]}, [(C, 5, 3), (C, 9, 2)]),
    (
        [(C, 5, 3), (C, 9, 2)],
        {"gap": 9, "forbidden": [("discrete_inputs", range(8, 9)), (C, range(8, 8))]},
        [(C, 5, 6)],
    ),
    ([(INPUT, 0, 100), (INPUT, 100, 100)], {}, [(INPUT, 0, 100), (INPUT, 100, 100)]),
    ([(H, 0, 125), (H, 10, 100)], {}, [(H, 0, 125)]),
    ([(H, 0, 260)], {}, [(H, 0, 125), (H, 125, 125), (H, 250, 10)]),
    ([(H, 0, 100, "float32")], {"max_registers": 125}, [(H, 0, 124), (H, 124, 76)]),
    (
        [(H, 0, 250), (H, 250, 5)],
        {"max_registers": 120},
        [(H, 0, 120), (H, 120, 120), (H, 240, 15)],
    ),
    ([(C, 65535), (C, 0, 2001)], {}, [(C, 0, 2000), (C, 2000, 1), (C, 65535, 1)]),
    ([], {}, []),
]


@each_case(("items", "options", "requests"), REQUESTS)
def test_items_share_reads(items: Any, options: Any, requests: list[tuple[str, int, int]]) -> None:
    plan = Plan(items, **options)
    assert [(table, cells[0], len(cells)) for table, cells in spans(plan)] == requests
    reads = [Read(*item) for item in items]
    if all(read.type is None for read in reads):
        assert plan.results(answers(plan)) == [
            [cell(read.table, read.address + at) for at in range(read.count)] for read in reads
        ]


def test_results_have_the_names_of_their_items() -> None:
    plan = Plan(
        {
            "level": ("holding_registers", 10, 2, "float32", "CDAB"),
            "name": Read("holding_registers", 14, 1, "string:4", padding=" "),
            "raw": ("holding_registers", 12, 3),
        }
    )
    assert plan.requests == (pdu.ReadHoldingRegisters(10, 6),)
    registers = values.value_type("float32", order="CDAB").encode_many([1.5, -2.25])
    registers += values.value_type("string:4", padding=" ").encode("ab")
    assert plan.results([registers]) == {
        "level": [1.5, -2.25],
        "name": ["ab"],
        "raw": registers[2:5],
    }


def test_a_count_may_be_left_out_before_a_type() -> None:
    short = Plan([(H, 0, "float32"), (H, 2, "float32", "CDAB"), (H, 4, "string:4", "DCBA")])
    full = [(H, 0, 1, "float32"), (H, 2, 1, "float32", "CDAB"), (H, 4, 1, "string:4", "DCBA")]
    cells = [[0x4248, 0, 0, 0x4248, 0x4241, 0x4443]]
    assert short.results(cells) == Plan(full).results(cells) == [[50.0], [50.0], ["ABCD"]]


def test_good_and_failed_values_are_separated_by_name() -> None:
    plan = Plan({"level": (H, 0, "float32"), "valves": (C, 0), "digits": (INPUT, 0, "bcd16")})
    refusal = IllegalDataAddress("refused")
    values = plan.results([refusal, [0x4248, 0], [0xFFFF]])
    assert values.good == {"level": [50.0]}
    assert list(values.failed) == ["valves", "digits"]
    assert values.failed["valves"] is values["valves"] is refusal
    assert isinstance(values.failed["digits"], NoValue)


def test_a_failed_request_is_the_result_of_its_own_items_only() -> None:
    plan = Plan([("coils", 0, 2), ("coils", 1, 2), ("coils", 9, 1), ("coils", 100, 3000)])
    assert len(plan.requests) == 4
    error = ModbusTimeoutError("no answer")
    good = answers(plan)
    assert plan.results([error, *good[1:]]) == [error, error, [cell("coils", 9)], good[2] + good[3]]
    assert plan.results([*good[:3], error])[2:] == [[cell("coils", 9)], error]


def test_each_result_is_a_new_list() -> None:
    plan = Plan([("coils", 0, 2), ("coils", 0, 2)])
    answer = [[True, False]]
    first, second = plan.results(answer)
    first.append(1)
    assert second == [True, False]
    assert answer == [[True, False]]


def test_bad_argument_is_named(refused: Refused) -> None:
    refused("wrong_plans.txt", lambda case: Plan(case[0], **case[1]))
    with pytest.raises(TypeError, match="items must be a list"):
        Plan(Read("coils", 1))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("results", "message"),
    [
        ([], "one for each of 2 requests, not 0"),
        ([[True], [True], [True]], "one for each of 2 requests, not 3"),
        ([[True], [True]], r"answers\[1\] must hold 2 values, not 1"),
    ],
)
def test_answers_to_other_requests_are_refused(results: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Plan([("coils", 0), ("coils", 5, 2)]).results(results)


def test_invalid_data_of_one_item_leaves_the_other_items() -> None:
    plan = Plan({
        "total": ("holding_registers", 0, 1, "bcd16"),
        "two": ("holding_registers", 1, 2, "bcd16"),
        "name": ("holding_registers", 3, 1, "string:2"),
        "clock": ("holding_registers", 4, 1, "date48"),
    })  # fmt: skip
    results = plan.results([[0x00FF, 0x0012, 0xA000, 0x80FF, 0, 0, 0]])
    assert results["two"] == [12, None]
    assert {name: (type(item), item.reason) for name, item in results.items() if name != "two"} == {
        "total": (NoValue, "InvalidData"),
        "name": (NoValue, "InvalidData"),
        "clock": (NoValue, "InvalidTime"),
    }
    assert str(results["total"]) == "items['total'] has no value: 00FF has digits other than 0..9"
    with pytest.raises(ValueError, match=r"registers\[0\] must be in 0\.\.65535, not 65536"):
        plan.results([[0, 65536, 0, 0, 0, 0, 0]])


def test_options_beside_a_plan_are_refused() -> None:
    plan = Plan([])
    assert planned(plan, {}) is plan
    for options in ({"gap": 1}, {"forbidden": [("coils", range(5))]}):
        with pytest.raises(ValueError, match="given to the plan"):
            planned(plan, options)  # type: ignore[arg-type]


# Items, borders of holding registers, and the requests.
BORDERED: list[Any] = [
    ([(H, 0, 20)], [10], [(0, 10), (10, 10)]),
    ([(H, 0, 5, "uint32")], [4], [(0, 4), (4, 6)]),
    ([(H, 8), (H, 9), (H, 10), (H, 11)], [10], [(8, 2), (10, 2)]),
    ([(H, 9), (H, 11)], [10], [(9, 1), (11, 1)]),
    ([(H, 0, 200)], [100], [(0, 100), (100, 100)]),
    ([(H, 0, 3)], [0, 3, 65535], [(0, 3)]),
    ([("coils", 0, 20)], [10], [(0, 20)]),
]


@each_case(("items", "borders", "requests"), BORDERED)
def test_no_request_crosses_a_forbidden_border(items, borders, requests) -> None:
    plan = Plan(items, gap=4, borders=[(H, at) for at in borders])
    assert [(item.address, item.count) for item in plan.requests] == requests  # type: ignore[attr-defined]


WRONG_BORDERS: list[Any] = [
    ([(H, 9, 1, "uint32")], [(H, 10)], r"items\[0\]: Read.* has a value across 10"),
    ([], [(H, 65536)], r"borders\[0\].address must be in 0\.\.65535, not 65536"),
    ([], [("files", 5)], r"borders\[0\].table must be one of"),
    ([], [5], r"borders\[0\] must be a pair \(table, address\), not 5"),
]


@each_case(("items", "borders", "message"), WRONG_BORDERS)
def test_invalid_borders_are_refused(items: Any, borders: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        Plan(items, borders=borders)


def test_plans_of_a_map_keep_its_borders() -> None:
    points = [Point(f"p{at}", H, at, border=at == 10) for at in range(20)]
    map = RegisterMap(points)
    for names, requests in (
        (None, [(0, 10), (10, 10)]),
        (["p8", "p9", "p11"], [(8, 2), (11, 1)]),  # without the point that begins the block
    ):
        plan = map.plan(names, gap=4)
        assert [(item.address, item.count) for item in plan.requests] == requests  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match="border must be true or false, not 1"):
        Point("a", H, 0, border=1)  # type: ignore[arg-type]


SIZES = {None: 1, "float32": 2, "int64": 4, "string:5": 3}


@st.composite
def any_items(draw: st.DrawFn) -> list[Read]:
    items = []
    for _ in range(draw(st.integers(0, 8))):
        table = draw(st.sampled_from(["coils", "holding_registers"]))
        kinds = [None] if table == "coils" else list(SIZES)
        items.append(
            Read(
                table,
                draw(st.integers(0, 40)),
                draw(st.integers(1, 12)),
                draw(st.sampled_from(kinds)),
            )
        )
    return items


def cells_of(read: Read) -> range:
    return range(read.address, read.address + read.count * SIZES[read.type])


def fewest(reads: list[Read], limit: int, gap: int, forbidden: set[int], borders: set[int]) -> int:
    """Return the fewest requests: try all ends for each, within the rules for cells."""
    addresses = {address for read in reads for address in cells_of(read)}
    together = []
    for read in reads:
        cells = cells_of(read)
        is_whole = len(cells) <= limit and not borders & set(cells[1:])
        step = len(cells) if is_whole else SIZES[read.type]
        together += [(at, at + step) for at in range(cells.start, cells.stop, step)]

    def allowed(start: int, stop: int) -> bool:
        edges = [start - 1, *sorted(addresses & set(range(start, stop))), stop]
        holes = max(second - first - 1 for first, second in pairwise(edges))
        crossed = borders & set(range(start + 1, stop))
        return holes <= gap and not forbidden & set(range(start, stop)) and not crossed

    count = 0
    while together:
        start = min(row[0] for row in together)
        stops = [
            stop
            for stop in range(start + 1, start + limit + 1)
            if stop - 1 in addresses and allowed(start, stop)
        ]
        rest = [[row for row in together if row[0] < start or row[1] > stop] for stop in stops]
        together = min(rest, key=len)
        count += 1
    return count


@given(
    reads=any_items(),
    gap=st.integers(0, 6),
    limit=st.integers(4, 30),
    closed=st.sets(st.integers(0, 90), max_size=6),
    borders=st.sets(st.integers(0, 90), max_size=3),
)
def test_plans_of_random_items_have_the_fewest_requests(
    reads: list[Read], gap: int, limit: int, closed: set[int], borders: set[int]
) -> None:
    borders -= {
        at for read in reads for at in cells_of(read) if (at - read.address) % SIZES[read.type]
    }
    addresses = {
        table: {at for read in reads if read.table == table for at in cells_of(read)}
        for table in ("coils", "holding_registers")
    }
    hidden = {table: closed - cells for table, cells in addresses.items()}
    plan = Plan(
        reads,
        gap=gap,
        forbidden=[(table, range(at, at + 1)) for table, cells in hidden.items() for at in cells],
        max_registers=limit,
        max_bits=limit,
        borders=[(table, at) for table in addresses for at in borders],
    )

    for table, cells in addresses.items():
        requests = [span for name, span in spans(plan) if name == table]
        assert requests == sorted(requests, key=lambda span: span.start)
        for span in requests:
            assert 1 <= len(span) <= limit
            assert not hidden[table] & set(span)
            assert not borders & set(span[1:])
            assert {span[0], span[-1]} <= cells
            inside = [at for at in span if at in cells]
            assert all(second - first - 1 <= gap for first, second in pairwise(inside))
        own = [read for read in reads if read.table == table]
        assert len(requests) == fewest(own, limit, gap, hidden[table], borders)
        most = sum(-(-read.count // (limit // SIZES[read.type])) for read in own)
        assert len(requests) <= most + len(borders) * len(own)

    for read, result in zip(reads, plan.results(answers(plan)), strict=True):
        registers = [cell(read.table, at) for at in cells_of(read)]
        assert repr(result) == repr(decoded(read, registers))
        is_whole = len(registers) <= limit and not borders & set(cells_of(read)[1:])
        step = len(registers) if is_whole else SIZES[read.type]
        for at in range(read.address, read.address + len(registers), step):
            together = range(at, at + step)
            assert any(
                table == read.table and set(together) <= set(span) for table, span in spans(plan)
            ), "torn"


def decoded(read: Read, registers: list[Any]) -> list[Any]:
    return registers if read.type is None else values.value_type(read.type).decode_many(registers)


@pytest.fixture
def context(url: str) -> Iterator[Client]:
    with Client(url, unit=UNIT) as client:
        yield client


def test_read_many_is_refused_as_a_whole_or_in_part(context: Client) -> None:
    items = [("coils", 10, 2), ("holding_registers", 99), ("holding_registers", 102)]
    with pytest.raises(IllegalDataAddress, match=r"address=99, count=4"):
        context.read_many(items, gap=2)
    with pytest.raises(IllegalDataAddress, match=r"address=99, count=1"):
        context.read_many(items, gap=2, forbidden=[("holding_registers", range(100, 102))])
    valves, refusal, level = context.read_many(items, return_exceptions=True)
    assert (valves, level) == ([True, False], [1002])
    assert isinstance(refusal, IllegalDataAddress)


def test_gaps_of_plans_are_read_from_the_device() -> None:
    def three(request: bytes) -> list[bytes]:
        return [mbap(request, bytes.fromhex("03 06 0001 0002 0003"))]

    with FakeServer(three) as server, Client(f"tcp://127.0.0.1:{server.port}") as context:
        items = [("holding_registers", 7), ("holding_registers", 9)]
        assert context.read_many(items, gap=1) == [[1], [3]]
        assert [request[7:] for request in server.requests] == [bytes.fromhex("03 0007 0003")]
        with pytest.raises(InvalidResponse):
            context.read_many([("holding_registers", 7, 2)])
