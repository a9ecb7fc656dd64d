"""
One value of a type, read and written with both clients.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, Device, Mapping, Server
from tests.support.cases import each_case

# The worked example of IEEE 754: 123456.0 is 47 F1 20 00.
MAPPING = Mapping(
    holding_registers={
        0: [0x47F1, 0x2000],
        10: [0x2000, 0x47F1],
        20: [0xFFFE],
        30: [0x4142, 0x4300],
    },
    input_registers={5: [0x1234, 0x5678], 9: [0x8001]},
)

READS = [
    (("holding_registers", 0, "float32"), {}, 123_456.0),
    (("holding_registers", 10, "float32"), {"order": "CDAB"}, 123_456.0),
    (("holding_registers", 20, "int16"), {}, -2),
    (("holding_registers", 30, "string:4"), {}, "ABC"),
    (("input_registers", 5, "bcd32"), {}, 12_345_678),
    (("input_registers", 9, "bits16"), {}, [True, *[False] * 14, True]),
]

WRONG = [
    (("coils", 0, "uint16"), ValueError, "table must be one of holding_registers, input_registers"),
    (("holding_registers", 0, "flaot32"), ValueError, "flaot32"),
    (("holding_registers", -1, "float32"), ValueError, "address"),
    (("holding_registers", 65535, "float32"), ValueError, "65535"),
    (("holding_registers", 0, "string:252"), ValueError, "string"),
]


def test_both_clients_read_one_value() -> None:
    async def read(url: str) -> list[Any]:
        async with AsyncClient(url) as plc:
            return [await plc.read_value(*where, **layout) for where, layout, _ in READS]  # type: ignore[arg-type, call-overload]

    expected = [value for *_, value in READS]
    with Server(Device(MAPPING)).background("tcp://127.0.0.1:0") as running:
        with Client(running.urls[0]) as plc:
            assert [plc.read_value(*where, **layout) for where, layout, _ in READS] == expected  # type: ignore[arg-type, call-overload]
        assert asyncio.run(read(running.urls[0])) == expected


@each_case(("where", "error", "message"), WRONG)
def test_wrong_arguments_are_refused_before_anything_is_sent(
    where: tuple[Any, ...], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        Client("tcp://192.0.2.10").read_value(*where)


WRITES = [each for each in READS if each[0][0] == "holding_registers"]

UNFIT = [
    (("input_registers", 0, 1, "uint16"), ValueError, "table must be holding_registers, not"),
    (("coils", 0, 1, "uint16"), ValueError, "table must be holding_registers, not 'coils'"),
    (("holding_registers", 0, 1, "flaot32"), ValueError, "flaot32"),
    (("holding_registers", 65535, 1, "float32"), ValueError, "65535"),
    (("holding_registers", 0, 65536, "uint16"), ValueError, r"^value must be in 0\.\.65535"),
    (("holding_registers", 0, [1], "uint16"), TypeError, "^value must be an integer"),
    (("holding_registers", 0, "1.5", "float32"), TypeError, "^value must be a number"),
]


def test_both_clients_write_one_value() -> None:
    async def write(url: str) -> None:
        async with AsyncClient(url) as plc:
            for (table, address, type_), layout, value in WRITES:
                await plc.write_value(table, address, value, type_, **layout)  # type: ignore[arg-type]

    def cells(mapping: Mapping) -> list[list[int]]:
        return [mapping.holding_registers[at : at + 2] for at in (0, 10, 20, 30)]

    for is_awaited in (False, True):
        written = Mapping(holding_registers=40)
        with Server(Device(written)).background("tcp://127.0.0.1:0") as running:
            if is_awaited:
                asyncio.run(write(running.urls[0]))
            else:
                with Client(running.urls[0]) as plc:
                    for (table, address, type_), layout, value in WRITES:
                        plc.write_value(table, address, value, type_, **layout)  # type: ignore[arg-type]
        assert cells(written) == [[0x47F1, 0x2000], [0x2000, 0x47F1], [0xFFFE, 0], [0x4142, 0x4300]]


@each_case(("what", "error", "message"), UNFIT)
def test_values_that_do_not_fit_are_refused_before_anything_is_sent(
    what: tuple[Any, ...], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        Client("tcp://192.0.2.10").write_value(*what)
