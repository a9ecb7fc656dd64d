"""
Wrong uses of the public face: type checkers must complain of every line marked
``# wrong``, and of no other. ``# later`` marks those that they do not see yet.

Nothing here runs.
"""

from __future__ import annotations

from libmodbus_py import AsyncClient, Context, RtuContext, Server, TcpContext

TcpContext("192.0.2.10", timout=1.0)  # wrong
TcpContext("192.0.2.10", framing="tpc")  # wrong
TcpContext("192.0.2.10", unit="17")  # wrong
TcpContext("192.0.2.10", native=None)  # wrong
RtuContext("/dev/ttyUSB0", parity="even")  # wrong
RtuContext("/dev/ttyUSB0", rs485="rts")  # wrong
Context.from_url("tcp://192.0.2.10", unti=3)  # wrong
Context.from_url("tcp://192.0.2.10", timeout="1")  # wrong
AsyncClient("tcp://192.0.2.10", retires=2)  # wrong
AsyncClient("tcp://192.0.2.10", unti=2)  # wrong


def blocking(plc: TcpContext) -> None:
    plc.read_values("holding_regs", 0, "float32")  # wrong
    plc.read_values("holding_registers", 0, "flaot32")  # wrong
    plc.read_values("holding_registers", 0, "float32", order="ABDC")  # wrong
    plc.read_values("coils", 0, "float32")  # wrong
    plc.write_values("input_registers", 0, [1.5], "float32")  # wrong
    plc.read_coils("0", 8)  # wrong
    plc.read_coils(0, cuont=8)  # wrong
    plc.read_coils(0)  # wrong
    plc.write_registers(0, 555)  # wrong
    plc.read_many({"level": ("coil", 0, 8)})  # wrong
    plc.read_many([("holding_registers", 0, 1, "flaot32")])  # wrong


def confused(plc: TcpContext) -> list[bool]:
    return plc.read_holding_registers(0, 8)  # wrong


async def asking(plc: AsyncClient) -> None:
    plc.read_coils(0, 8)  # wrong
    await plc.read_values("holding_regs", 0, "float32")  # wrong
    await plc.read_coils("0", 8)  # wrong


def forgotten_await(plc: AsyncClient) -> list[bool]:
    return plc.read_coils(0, 8)  # wrong


def serving(server: Server) -> None:
    server.background(1502)  # wrong
