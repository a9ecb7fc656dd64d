"""
Wrong uses of the public face: type checkers must complain of every line marked
``# wrong``, and of no other.

Nothing here runs.
"""

from __future__ import annotations

from meter import Meter

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    Gateway,
    Hook,
    Mapping,
    Point,
    Read,
    Route,
    Security,
    Server,
    load_map,
    pdu,
)
from libmodbus_py.listen import Separator, listen

Client("tcp://192.0.2.10", timout=1.0)  # wrong
Client("tcp://192.0.2.10", unit="17")  # wrong
Client("tcp://192.0.2.10", accept_unit="all")  # wrong
Client("tcp://192.0.2.10", write_function=16)  # wrong
Client("tcp://192.0.2.10", ids="any")  # wrong
Client("tcp://192.0.2.10", idle_close="5")  # wrong
Client("tcp://192.0.2.10", broadcast=0)  # wrong
Client("tcp://192.0.2.10", 502)  # wrong
Client("tcp://192.0.2.10", trace="wire.log")  # wrong
Client("rtu:///dev/ttyUSB0", parity="mark")  # wrong
Client("rtu:///dev/ttyUSB0", rs485=17)  # wrong
Client("ascii:///dev/ttyUSB0", delimiter="\n")  # wrong
Client("tcp://192.0.2.10", unti=3)  # wrong
Client("tcp://192.0.2.10", timeout="1")  # wrong
AsyncClient("tcp://192.0.2.10", retires=2)  # wrong
AsyncClient("tcp://192.0.2.10", unti=2)  # wrong
Client("tcp://192.0.2.10", may_send=print)  # wrong
AsyncClient("tcp://192.0.2.10", statistics={})  # wrong
Security("own.pem", trust=5)  # wrong
Security("own.pem", trust="ca.pem", password=b"x")  # wrong
Security("own.pem", ca="ca.pem")  # wrong
Client("tls://192.0.2.10", security="own.pem")  # wrong
Client("tls://192.0.2.10", framing="rtu")  # wrong
Read("coil", 0)  # wrong


def blocking(plc: Client) -> None:
    plc.read_values("holding_regs", 0, "float32")  # wrong
    plc.read_values("holding_registers", 0, "flaot32")  # wrong
    plc.read_values("holding_registers", 0, "float32", order="ABDC")  # wrong
    plc.read_values("coils", 0, "float32")  # wrong
    plc.read_coils(0, 1, device_id=3)  # wrong
    plc.read_coils(adress=0, count=1)  # wrong
    plc.for_unit(3, timout=1)  # wrong
    plc.write_value("holding_registers", 0, 1.5, "flaot32")  # wrong
    plc.write_values("input_registers", 0, [1.5], "float32")  # wrong
    plc.read_coils("0", 8)  # wrong
    plc.read_coils(0, cuont=8)  # wrong
    plc.read_coils(0)  # wrong
    plc.write_registers(0, 555)  # wrong
    plc.read_many({"level": "coils"})  # wrong
    plc.read_many([("holding_registers", "0", ["float32"])])  # wrong
    plc.read_many([Read("holding_registers", 0, 1, "float32", "ABDC")])  # wrong
    print(plc.read_many({"a": ("holding_registers", 0, "float32")})["a"].value)  # wrong
    print(plc.read_many({"a": ("coils", 0)}, return_exceptions=True)["a"][0])  # wrong
    plc.read_many([("coils", 0, 8)], gpa=4)  # wrong
    meter = load_map("meter.csv")
    plc.read_map(meter, gpa=4)  # wrong
    plc.unreadable(5)  # wrong
    plc.write_map(meter, ["setpoint"])  # wrong
    Point("level", "coil", 0)  # wrong
    Point("level", "coils", 0, access="rw")  # wrong
    plc.for_unit(3, timeuot=0.3)  # wrong
    plc.execute(pdu.ReadCoils(0, 8), timeout="0.1")  # wrong
    print(plc.statistics.late_answer)  # wrong


def confused(plc: Client) -> list[bool]:
    return plc.read_holding_registers(0, 8)  # wrong


async def asking(plc: AsyncClient) -> None:
    plc.read_coils(0, 8)  # wrong
    await plc.read_values("holding_regs", 0, "float32")  # wrong
    await plc.read_coils(0, 1, device_id=3)  # wrong
    await plc.read_value("holding_registers", 0, "float32", word_order="ABCD")  # wrong
    await plc.execute(pdu.ReadCoils(0, 8), unit=3)  # wrong
    await plc.read_map(load_map("meter.csv"), gaps=3)  # wrong
    await plc.read_coils("0", 8)  # wrong
    await plc.read_many({"level": 8})  # wrong
    await plc.read_map(5)  # wrong


def forgotten_await(plc: AsyncClient) -> list[bool]:
    return plc.read_coils(0, 8)  # wrong


def serving(server: Server, mapping: Mapping) -> None:
    server.background(1502)  # wrong
    mapping.holding_registers.write(0, 1.5, "flaot32")  # wrong
    Mapping(holding_registers="100")  # wrong
    Server(mapping)  # wrong
    Server(Device(mapping), trace="wire.log")  # wrong
    Hook(print, holding_regs=range(8))  # wrong
    Hook(print, coils=8)  # wrong
    Device(mapping, before_read=range(8))  # wrong


def passing_on(route: Route) -> None:
    Gateway("tcp://192.0.2.10")  # wrong
    Gateway([route], writesfirst=True)  # wrong
    Route("tcp://192.0.2.10", [20], cache="1 s")  # wrong


def hearing(separator: Separator) -> None:
    listen("rtu:///dev/ttyUSB0", betwen="rtu+tcp://192.0.2.10")  # wrong
    Separator("tcp")  # wrong
    separator.feed(b"", 0.0, "master")  # wrong


def misspelt(plc: Client) -> None:
    meter = Meter(plc)
    print(meter.volttage)  # wrong
    meter.read("volttage")  # wrong
    meter.write(sepoint=21.5)  # wrong
    meter.write(setpoint="warm")  # wrong
    meter.voltage = 230.5  # wrong
    meter.write(voltage=230.5)  # wrong
    print(meter.reset)  # wrong
    text: str = meter.voltage  # wrong
    print(text)
    count: int = plc.read_value("holding_registers", 0, "float32")  # wrong
    print(count)
    plc.read_value("holding_registers", 0, "flaot32")  # wrong
    plc.read_value("holding_registers", 0, "float32", 2)  # wrong
    Meter("tcp://192.0.2.10")  # wrong
    Device.of_map(load_map("meter.csv"), {"setpoint": 20}, after_writes=print)  # wrong
    Device.of_map(5)  # wrong


async def misspelt_and_awaited(plc: AsyncClient) -> None:
    meter = Meter(plc)
    await meter.write(sepoint=21.5)  # wrong
    await meter.read("volttage")  # wrong
    values: list[str] = await plc.read_values("holding_registers", 0, "float32")  # wrong
    print(values)
    await Meter(Client("tcp://192.0.2.10")).read()  # wrong
    for polled in plc.watch({"level": ("coils", 0, 8)}, every=1):  # wrong
        print(polled)
    async for awaited in Client("tcp://192.0.2.10").watch("meter.toml", every=1):  # wrong
        print(awaited)
