"""
Endless loops over items in variables, as programs have them, which type checkers must take as they
are, the strictest too.

Nothing here runs.
"""
# pyright: strict

from __future__ import annotations

from datetime import datetime
from typing import assert_type

from libmodbus_py import AsyncClient, Client, ModbusError, Plan, Read
from libmodbus_py.maps.items import NamedValues, Values

TWO = {"temperature": ("holding_registers", 100, 1, "float32"), "valves": ("coils", 0, 8)}
WITHOUT_COUNT = {"temperature": ("holding_registers", 100, "float32"), "valve": ("coils", 0)}
EQUAL = {"in": ("input_registers", 0, "int16"), "out": ("input_registers", 1, "int16")}
WITH_ORDER = {7: ("holding_registers", 100, 2, "float32", "CDAB"), 8: ("coils", 0, 8)}
READS = {"temperature": Read("holding_registers", 100, type="float32"), "valve": Read("coils", 0)}
IN_A_LIST = [("holding_registers", 100, 1, "float32"), ("coils", 0, 8)]


def run() -> None:
    plc = Client("tcp://192.0.2.10", unit=17)
    for values in plc.watch(TWO, every=1):
        for name, error in values.failed.items():
            print("no", name, error.sent)
        for name, value in values.good.items():
            assert_type(name, str)
            assert_type(value[0], bool | int | float | str | datetime | list[bool] | None)
            print(name, value[0])
    for floats in plc.watch({"level": ("holding_registers", 100, "float32")}, every=1):
        for level in floats.good.values():
            print(level[0] * 2)


async def run_with_asyncio() -> None:
    plc = AsyncClient("tcp://192.0.2.10", unit=17)
    async for values in plc.watch(TWO, every=1):
        for name, error in values.failed.items():
            print("no", name, error.sent)
        for name, value in values.good.items():
            print(name, value[0])
    assert_type(await plc.read_many(TWO), dict[str, Values])
    assert_type(await plc.read_many(TWO, return_exceptions=True), NamedValues[str, Values])


def read(plc: Client) -> None:
    assert_type(plc.read_many(WITHOUT_COUNT), dict[str, Values])
    assert_type(plc.read_many(EQUAL, gap=4), dict[str, Values])
    assert_type(plc.read_many(WITH_ORDER, return_exceptions=True), NamedValues[int, Values])
    assert_type(plc.read_many(READS), dict[str, Values])
    assert_type(plc.read_many(IN_A_LIST), list[Values])
    for values in plc.watch(IN_A_LIST, every=1):
        assert_type(values, list[Values | ModbusError])
    Plan(TWO)
    Plan(READS, gap=4)
    Plan(IN_A_LIST)
