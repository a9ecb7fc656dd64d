"""Rules for roles: what they allow, held against a model that counts items one by one."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.checks import REQUEST_OBJECTS
from libmodbus_py import Access, Allow, Device, Mapping, Rules, pdu
from libmodbus_py.device.access import ACCESSES
from libmodbus_py.serve import Caller
from tests.support.cases import each_case

# Rules use addresses only: values that tests write may remain.
MAPPING = Mapping(65536, 65536, 65536, 65536)
FILES = {number: [0] * 100 for number in (3, 4)}


def device(rules: Rules) -> Device:
    return Device(
        MAPPING, files=FILES, fifos={0x04DE: [1]}, canopen=lambda data: data, authorize=rules
    )


def code(answer: bytes) -> int:
    return answer[1] if answer[0] & 0x80 else 0


ALL = Allow("all", "all", "all")


def test_nothing_is_allowed_that_no_rule_allows() -> None:
    empty = device(Rules({}))
    other = device(Rules({"Engineer": ALL, "Viewer": Allow()}))
    for request in REQUEST_OBJECTS:
        assert code(empty.answer(request.encode())) == 1
        for role in (None, "Viewer", "engineer", "Engineer ", "Engineer\0", ""):
            assert code(other.answer(request.encode(), Caller(role=role))) == 1


def test_the_rule_all_allows_every_request() -> None:
    for role in ("Engineer", None):
        guarded = device(Rules({role: ALL}))
        refusals = [
            type(request)
            for request in REQUEST_OBJECTS
            if code(guarded.answer(request.encode(), Caller(role=role))) == 1
        ]
        assert refusals == [pdu.RawRequest]  # a function that nobody is


TABLES = {
    pdu.ReadCoils(5, 2): ("read", "coils"),
    pdu.ReadDiscreteInputs(5, 2): ("read", "discrete_inputs"),
    pdu.ReadHoldingRegisters(5, 2): ("read", "holding_registers"),
    pdu.ReadInputRegisters(5, 2): ("read", "input_registers"),
    pdu.WriteCoil(5, True): ("write", "coils"),
    pdu.WriteRegister(5, 1): ("write", "holding_registers"),
    pdu.WriteCoils(5, (True,)): ("write", "coils"),
    pdu.WriteRegisters(5, (1,)): ("write", "holding_registers"),
    pdu.MaskWriteRegister(5, 1, 2): ("write", "holding_registers"),
    pdu.ReadFileRecords(((4, 1, 2),)): ("read", "file"),
    pdu.WriteFileRecords(((4, 1, (2,)),)): ("write", "file"),
    pdu.ReadFifoQueue(0x04DE): ("read", "fifo"),
}


def test_the_examples_name_every_function_that_touches_tables() -> None:
    assert {type(request) for request in TABLES} == ACCESSES.keys() - {pdu.ReadWriteRegisters}


@each_case("request_", TABLES, ids=lambda each: type(each).__name__)
def test_a_table_is_for_all_functions_that_touch_it(request_: pdu.Request[Any]) -> None:
    for name, tables in (
        (
            "read",
            ("coils", "discrete_inputs", "holding_registers", "input_registers", "fifo", "file"),
        ),
        ("write", ("coils", "holding_registers", "file")),
    ):
        for table in tables:
            is_allowed = TABLES[request_] == (name, table)
            answer = device(Rules({None: Allow(**{name: [table]})})).answer(request_.encode())
            assert code(answer) == (0 if is_allowed else 1), (name, table)


def test_function_23_needs_both() -> None:
    request = pdu.ReadWriteRegisters(0, 10, 100, (1, 2)).encode()
    reads, writes = Access("holding_registers", 0, 10), Access("holding_registers", 100, 2)
    for read, write, result in (
        ([reads], [writes], 0),
        ([reads], [], 1),
        ([], [writes], 1),
        ([writes], [reads], 1),
        ("all", [Access("holding_registers", 100, 1)], 1),
        ([Access("holding_registers", 1, 9)], "all", 1),
    ):
        assert code(device(Rules({None: Allow(read, write)})).answer(request)) == result


def test_a_request_for_two_files_needs_both() -> None:
    request = pdu.ReadFileRecords(((4, 1, 2), (3, 9, 2))).encode()
    four, three = Access("file", 1, 2, file=4), Access("file", 0, 100, file=3)
    for read, result in (([four, three], 0), ([four], 1), ([three], 1), (["file"], 0)):
        assert code(device(Rules({None: Allow(read)})).answer(request)) == result


runs = st.tuples(st.integers(0, 30), st.integers(1, 12))


@settings(max_examples=100)
@given(st.lists(runs, max_size=6), runs)
def test_parts_of_a_table_cover_what_their_items_do(
    ranges: list[tuple[int, int]], range_: tuple[int, int]
) -> None:
    device_ = device(Rules({None: Allow([Access("holding_registers", *run) for run in ranges])}))
    items = {item for first, count in ranges for item in range(first, first + count)}
    first, count = range_
    is_allowed = items.issuperset(range(first, first + count))
    read = pdu.ReadHoldingRegisters(first, count)
    assert (code(device_.answer(read.encode())) == 0) == is_allowed
    for other in (pdu.ReadInputRegisters(first, count), pdu.WriteRegisters(first, (0,) * count)):
        assert code(device_.answer(other.encode())) == 1


def test_the_last_item_of_a_table() -> None:
    rules = Rules({None: Allow([Access("coils", 65535, 1)])})
    assert code(device(rules).answer(pdu.ReadCoils(65535, 1).encode())) == 0
    assert code(device(rules).answer(pdu.ReadCoils(65534, 2).encode())) == 1


OTHERS = [request for request in REQUEST_OBJECTS if type(request) not in ACCESSES]


@each_case("request_", OTHERS, ids=lambda each: type(each).__name__)
def test_functions_that_touch_no_table_are_allowed_by_their_code(request_) -> None:
    data = request_.encode()
    for functions in ((7,), (8,), (11,), (12,), (17,), (43,), (65,), (7, 8, 11, 12, 17, 43)):
        rules = Rules({None: Allow("all", "all", functions)})
        is_allowed = code(device(rules).answer(data)) != 1
        # Nobody is function 65: it gets exception 1 either way.
        assert is_allowed == (request_.function in functions and request_.function != 65)


@each_case(
    ("functions", "data", "result"),
    [
        (["8/0"], b"\x08\x00\x00\x12\x34", 0),
        (["8/0"], b"\x08\x00\x02\x00\x00", 1),
        (["8/2", "8/11"], b"\x08\x00\x0b\x00\x00", 0),
        (["43/14"], b"\x2b\x0e\x01\x00", 0),
        (["43/14"], b"\x2b\x0d\x01\x00", 1),
        (["43/13"], b"\x2b\x0d\x01\x00", 0),
        (["43/13"], b"\x2b\x0e\x01\x00", 1),
        ([43], b"\x2b\x0e\x01\x00", 0),
        ([43], b"\x2b\x0d\x01\x00", 0),
    ],
)
def test_sub_functions_and_mei_types(functions: list[str], data: bytes, result: int) -> None:
    assert code(device(Rules({None: Allow(functions=functions)})).answer(data)) == result


@each_case(
    ("allow", "data", "result"),
    [
        (Allow(read=["coils"]), b"\x01\x00", 3),  # a role with some reads: the error is explained
        (Allow(read=[Access("coils", 9, 1)]), b"\x01\x00", 3),
        (Allow(read=["coils"]), b"\x03\x00", 1),  # may send no request of the function
        (Allow(read=["coils"]), b"\x05\x00", 1),
        (Allow(write=["coils"]), b"\x05\x00", 3),
        (Allow(write=["coils"]), b"\x06\x00", 1),
        (Allow(write=["coils"]), b"\x01\x00", 1),
        (Allow(read=["holding_registers"]), b"\x17\x00", 1),
        (Allow(write=["holding_registers"]), b"\x17\x00", 1),
        (Allow(["holding_registers"], ["holding_registers"]), b"\x17\x00", 3),
        (Allow(functions=[17]), b"\x03\x00", 1),
        (Allow(functions=[17]), b"\x11\x00", 3),
        (Allow("all", "all"), b"\x11\x00", 1),
        (Allow(functions=["43/14"]), b"\x2b", 3),
        (Allow(), b"\x2b", 1),
        (ALL, b"\x5a", 1),
    ],
)
def test_bad_requests_are_explained_if_allowed(allow: Allow, data: bytes, result: int) -> None:
    assert code(device(Rules({None: allow})).answer(data)) == result


@each_case(
    ("make", "message"),
    [
        (lambda: Rules([]), "roles must be {role: Allow(...)}, not list"),
        (lambda: Rules({"x": "all"}), "roles['x'] must be Allow(...), not str"),
        (lambda: Rules({1: ALL}), "a role must be text or None, not 1"),
        (lambda: Rules({"": ALL}), "the role must have 1..255 bytes"),
        (lambda: Rules({"a\n": ALL}), "control characters"),
        (lambda: Allow("coils"), "read must be \"all\" or a list, not 'coils'"),
        (lambda: Allow(5), 'read must be "all" or a list, not 5'),
        (lambda: Allow(["coil"]), "read[0]: the table must be one of coils, "),
        (lambda: Allow(["all"]), "read[0]: the table must be one of coils, "),
        (lambda: Allow([5]), "read[0] must be the name of a table or Access(...), not 5"),
        (
            lambda: Allow(write=["input_registers"]),
            "write[0]: the table must be one of coils, holding",
        ),
        (lambda: Allow(write=["fifo"]), "write[0]: the table must be one of coils, holding"),
        (lambda: Allow([Access("coil", 0, 1)]), "read[0]: the table must be one of"),
        (lambda: Allow([Access("coils", 65536, 1)]), "read[0].address must be in 0..65535"),
        (lambda: Allow([Access("coils", -1, 1)]), "read[0].address must be in 0..65535"),
        (lambda: Allow([Access("coils", 65535, 2)]), "read[0].count must be in 1..1, not 2"),
        (lambda: Allow([Access("coils", 0, 0)]), "read[0].count must be in 1..65536, not 0"),
        (lambda: Allow([Access("coils", 0, 1, file=1)]), "read[0].file must be in 0..0"),
        (lambda: Allow([Access("file", 0, 1)]), "read[0].file must be in 1..65535"),
        (lambda: Allow([Access("file", 0, 10001, file=1)]), "read[0].count must be in 1..10000"),
        (lambda: Allow([Access("coils", 0, 1, unit=3)]), "mean nothing in Access("),
        (lambda: Allow([Access("coils", 0, 1, role="x")]), "mean nothing in Access("),
        (
            lambda: Allow(functions=[3]),
            "functions[0]: 3 touches tables: allow them by read and write",
        ),
        (lambda: Allow(functions=[23]), "functions[0]: 23 touches tables"),
        (lambda: Allow(functions=[0]), "functions[0] must be in 1..127"),
        (lambda: Allow(functions=[128]), "functions[0] must be in 1..127"),
        (lambda: Allow(functions=[True]), "functions[0] must be an integer"),
        (lambda: Allow(functions=["all"]), "functions[0] must be a code, or such as"),
        (lambda: Allow(functions=["17/1"]), "functions[0] must be a code, or such as"),
        (lambda: Allow(functions=["43/256"]), "functions[0] must be a code, or such as"),
        (lambda: Allow(functions=["8/99999"]), "functions[0] must be a code, or such as"),
        (lambda: Allow(functions=17), 'functions must be "all" or a list, not 17'),
    ],
)
def test_wrong_rules_are_refused_when_they_are_made(make: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError)) as caught:
        make()
    assert message in str(caught.value)


def test_rules_do_not_follow_later_changes_of_their_dict() -> None:
    roles = {"a": Allow(read=iter(["coils"]), functions=iter([17]))}
    rules = Rules(roles)
    roles["b"] = ALL
    device_ = device(rules)
    for _ in range(2):
        assert code(device_.answer(pdu.ReadCoils(0, 1).encode(), Caller(role="a"))) == 0
        assert code(device_.answer(b"\x11", Caller(role="a"))) == 0
    assert code(device_.answer(b"\x11", Caller(role="b"))) == 1
    assert roles["a"] == Allow(["coils"], functions=[17])
    assert "'a': Allow(read=('coils',)" in repr(rules)
