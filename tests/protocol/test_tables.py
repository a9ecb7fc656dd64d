"""
The four tables, and that their limits are those of the requests.
"""

from __future__ import annotations

from typing import get_args

import pytest

from libmodbus_py import Mapping, pdu
from libmodbus_py.protocol.tables import TABLE_SIZE, TABLES, RegisterTable, Table
from tests.support.cases import each_case


def test_names_are_those_of_mappings_and_type_checkers() -> None:
    bits, registers = get_args(Table)[:2], get_args(RegisterTable)
    assert {*bits, *registers} == set(TABLES) == set(get_args(Table))
    assert [name for name, rules in TABLES.items() if rules.is_bits] == list(bits)
    for name in TABLES:
        assert len(getattr(Mapping(**{name: 3}), name)) == 3


@each_case("name", TABLES)
def test_reads_take_no_more(name: str) -> None:
    rules = TABLES[name]
    request = rules.read(TABLE_SIZE - rules.most_read, rules.most_read)
    assert len(request.encode()) == 5
    result = [index % 2 for index in range(rules.most_read)]
    assert request.decode_response(request.encode_response(result)) == result
    for address, count in ((0, rules.most_read + 1), (TABLE_SIZE, 1), (TABLE_SIZE - 1, 2)):
        with pytest.raises(ValueError, match="must"):
            rules.read(address, count)


@pytest.mark.parametrize(
    ("name", "write"), [("coils", pdu.WriteCoils), ("holding_registers", pdu.WriteRegisters)]
)
def test_writes_take_no_more(name: str, write: type[pdu.WriteCoils | pdu.WriteRegisters]) -> None:
    most = TABLES[name].most_written
    assert len(write(0, (1,) * most).encode()) <= pdu.MAX_PDU
    with pytest.raises(ValueError, match="values must hold"):
        write(0, (1,) * (most + 1))


def test_inputs_are_not_written() -> None:
    assert [name for name, rules in TABLES.items() if not rules.most_written] == [
        "discrete_inputs",
        "input_registers",
    ]
