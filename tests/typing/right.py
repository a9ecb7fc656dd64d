"""
Right uses of the public face, which type checkers must take as they are.

Nothing here runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, assert_type

from meter import Meter

from libmodbus_py import (
    Access,
    AsyncClient,
    Client,
    Device,
    Gateway,
    Hook,
    Mapping,
    ModbusError,
    Plan,
    Point,
    Read,
    RegisterMap,
    Route,
    Security,
    Server,
    State,
    TracedFrame,
    load_map,
    pdu,
)
from libmodbus_py.bound import UnreadableItem
from libmodbus_py.listen import Separator, Transaction, listen
from libmodbus_py.maps.items import NamedValues, Values
from libmodbus_py.maps.watched import PolledValues
from libmodbus_py.protocol.words import TypeName, string_type

ALL = [
    Client("rtu+tcp://192.0.2.10", unit=17, timeout=1.0),
    Client("udp://192.0.2.10:502", unit=17),
    Client(
        "rtu:///dev/ttyUSB0", baudrate=19200, parity="E", stop_bits=1, rs485="kernel", silence=0.01
    ),
    Client("ascii:///dev/ttyUSB0", baudrate=9600, parity="N", data_bits=7),
]
Client("tcp://192.0.2.10", retries=2, trace=print)
Client("tcp://192.0.2.10", request_spacing=0.01, connect_delay=0.5, keepalive=None)
Client("tcp://192.0.2.10", accept_unit="any", max_pause=5, timeouts_before_reconnect=1)
Client("tcp://192.0.2.10", write_function="single").for_unit(2, write_function="multiple")
Client("tcp://192.0.2.10", ids="ignore", idle_close=5)
Client("rtu:///dev/ttyUSB0", unit=0, broadcast=False)
Client("ascii:///dev/ttyUSB0", delimiter=0x0A)
Client("rtu:///dev/ttyUSB0", rs485=lambda is_sending: None)
Client("rtu:///dev/ttyUSB0", rs485=None, rts_delay=None, echo=True, busy_retries=3, turnaround=0.2)
Client("tcp://192.0.2.10?unit=17", timeout=0.5, retries=1)
Client("rtu:///dev/ttyUSB0", baudrate=9600, parity="N")
AsyncClient("tcp://192.0.2.10", unit=17, max_in_flight=4, on_state=print)
AsyncClient("rtu:///dev/ttyUSB0", baudrate=9600, parity="N")
AsyncClient("tcp://192.0.2.10", may_send=lambda: True)
AsyncClient("tcp://192.0.2.10", retries=2, trace=print)
AsyncClient("tcp://192.0.2.10", statistics=AsyncClient("tcp://192.0.2.11").statistics)
OWN = Security("own.pem", "own-key.pem", trust="ca.pem", server_name="plc.example", password="x")
Security(certificate="own.pem", key="own-key.pem", trust="ca.pem")
Security(Path("own.pem"), pin=["device.pem", Path("other.pem"), "ab" * 32])
Client("tls://192.0.2.10", security=OWN, unit=17, timeout=1.0)
Client("tls://192.0.2.10", security=OWN)
AsyncClient("tls://192.0.2.10", security=OWN)


def told(state: State, error: ModbusError | None) -> None:
    assert_type(error.endpoint if error else "", str)


def traced(each: TracedFrame) -> None:
    assert_type(each.adu, bytes)
    assert_type(each.unit, int | None)


Client("udp://192.0.2.10", on_state=told, trace=traced)


def blocking(plc: Client) -> None:
    assert_type(plc.read_coils(0, 8), list[bool])
    assert_type(plc.read_holding_registers(address=0, count=8), list[int])
    assert_type(plc.read_file_records([(4, 1, 2)]), list[list[int]])
    assert_type(plc.read_device_identification("regular"), pdu.DeviceIdentification)
    assert_type(plc.diagnostics(0, 0x1234), int)
    assert_type(plc.execute(pdu.ReadCoils(0, 8)), list[bool])
    assert_type(plc.execute(pdu.ReportServerId()), pdu.ServerId)
    plc.write_coil(0, True)
    plc.write_registers(0, (number for number in range(8)))


def handles(plc: Client) -> None:
    assert_type(plc.for_unit(3), Client)
    assert_type(plc.for_unit(3, timeout=0.3, retries=1).read_coils(0, 8), list[bool])
    assert_type(plc.execute(pdu.ReadCoils(0, 8), timeout=0.1, retries=2), list[bool])
    assert_type(plc.statistics.late_answers, int)
    assert_type(plc.statistics.last_success, float | None)
    assert_type(plc.state, State)
    with plc as same:
        assert_type(same, Client)
    plc.timeout = 0.5


def values(plc: Client) -> None:
    plc.read_values("holding_registers", 100, "float32", 2, order="CDAB")
    plc.read_values("input_registers", 100, "string:16", encoding="latin-1", padding=" ")
    plc.write_value("holding_registers", 100, "pump", "string:8", padding=" ")
    plc.write_value("holding_registers", 100, "pump", string_type(77))
    assert_type(plc.read_value("holding_registers", 100, string_type(77)), str)
    plc.write_values("holding_registers", 100, [3.14], "float64", order="DCBA")


def typed(plc: Client, type: TypeName) -> None:
    assert_type(plc.read_value("holding_registers", 100, "float32", order="CDAB"), float)
    assert_type(plc.read_value("input_registers", 100, "uint16"), int)
    assert_type(plc.read_value("input_registers", 100, "bcd32"), int)
    assert_type(plc.read_value("input_registers", 100, "string:16", padding=" "), str)
    assert_type(plc.read_value("input_registers", 100, "bits16"), list[bool])
    plc.read_value("input_registers", 100, type)
    assert_type(plc.read_values("holding_registers", 100, "float64", 2), list[float])
    assert_type(plc.read_values("holding_registers", 100, type="int64", count=2), list[int])
    assert_type(plc.read_values("holding_registers", 100, "string:8", order="BADC"), list[str])
    assert_type(plc.read_values("holding_registers", 100, "bits32"), list[list[bool]])
    assert_type(plc.for_unit(3).read_value("holding_registers", 100, "float16"), float)


def named_values() -> None:
    map = load_map("meter.csv")
    device = Device.of_map(map, {"setpoint": 20}, after_write=print, files={4: [0]})
    device["setpoint"] = 21.5
    device.update({"setpoint": 21.5, "run": True})
    assert_type(device["setpoint"], Any)
    assert_type(device.points["setpoint"], Point)
    Device(Mapping(coils=8), points=map)
    device.save("meter.state")
    device.load(Path("meter.state"))


def classes(plc: Client) -> None:
    meter = Meter(plc, gap=4)
    assert_type(meter.read(), None)
    meter.read("voltage", "energy_total")
    assert_type(meter.voltage, float)
    assert_type(meter.energy_total, int)
    assert_type(meter.serial_number, str)
    assert_type(meter.run, bool)
    assert_type(meter.write(setpoint=21.5, run=True), None)
    bound = load_map("meter.csv").bind(plc, gap=4)
    bound.read("voltage")
    assert_type(bound.voltage, Any)
    bound.write(setpoint=21.5)


async def awaited_classes(plc: AsyncClient) -> None:
    meter = Meter(plc)
    assert_type(await meter.read("voltage"), None)
    await meter.write(setpoint=21, reset=True)
    assert_type(meter.voltage, float)
    assert_type(await plc.read_value("holding_registers", 0, "float32"), float)
    assert_type(await plc.read_values("holding_registers", 0, "uint32", 4), list[int])
    bound = load_map("meter.csv").bind(plc)
    await bound.read()


def many(plc: Client) -> None:
    for key, read in plc.read_many({"level": ("coils", 0, 8)}).items():
        assert_type(key, str)
        assert_type(read, list[bool])
    for number in plc.read_many({7: ("coils", 0, 8)}, gap=4):
        assert_type(number, int)
    level = Read("holding_registers", 0, 1, "float32", "CDAB")
    assert_type(plc.read_many([("coils", 0), level]), list[Values])
    text = plc.read_many([("input_registers", 0, 1, "string:8", "ABCD", "latin-1", " ")])
    assert_type(text, list[Values])
    floats = plc.read_many({1: ("holding_registers", 0, 2, "float32", "CDAB")}, gap=2)
    assert_type(floats, dict[int, list[float]])
    counts = plc.read_many({"a": ("input_registers", 0), "b": ("holding_registers", 2, "int32")})
    assert_type(counts, dict[str, list[int]])
    digits = plc.read_many({"a": ("holding_registers", 2, 3, "bcd16")})  # an F is None
    assert_type(digits, dict[str, Values])
    mixed = plc.read_many({"a": ("coils", 3), "b": ("holding_registers", 2, "float32", "CDAB")})
    assert_type(mixed, dict[str, Values])
    results = plc.read_many([("coils", 0, 8)], return_exceptions=True)
    assert_type(results, list[Values | ModbusError])
    by_name = plc.read_many({"a": ("holding_registers", 0, "float64")}, return_exceptions=True)
    assert_type(by_name.good, dict[str, list[float]])
    assert_type(by_name.failed, dict[str, ModbusError])
    assert_type(by_name["a"], list[float] | ModbusError)
    plc.read_many(Plan({"level": ("coils", 0, 8)}, forbidden=[("coils", range(4))]))
    assert_type(plc.execute_many([pdu.ReadCoils(0, 8), pdu.ReportServerId()]), list[Any])
    for values in plc.watch({"level": ("coils", 0, 8)}, every=1, gap=4):
        assert_type(values, NamedValues[str, list[bool]])


def named(plc: Client) -> None:
    meter = load_map(Path("meter.csv"))
    assert_type(meter["level"], Point)
    assert_type(plc.read_map(meter), dict[str, Any])
    tolerant = plc.read_map(meter, ["level"], return_exceptions=True, gap=4)
    assert_type(tolerant.failed, dict[str, ModbusError])
    assert_type(plc.unreadable(meter), list[UnreadableItem])
    assert_type(plc.unreadable(meter.plan(["level"])), list[UnreadableItem])
    plc.write_map(meter, {"setpoint": 21.5, "run": True}, multiple=True)
    map_ = RegisterMap([Point("level", "holding_registers", 100, type="float32", scale=0.1)])
    assert_type(plc.read_many(map_.plan(["level"])), Any)
    assert_type(map_["level"].decode([0, 0]), Any)


async def asking(plc: AsyncClient) -> None:
    assert_type(await plc.read_map("meter.toml"), dict[str, Any])
    await plc.write_map(load_map("meter.toml"), {"setpoint": 21.5})
    assert_type(await plc.read_coils(0, 8), list[bool])
    assert_type(await plc.read_holding_registers(address=0, count=8), list[int])
    assert_type(await plc.read_device_identification("regular"), pdu.DeviceIdentification)
    assert_type(await plc.execute(pdu.ReportServerId(), timeout=0.1), pdu.ServerId)
    assert_type(plc.for_unit(3), AsyncClient)
    await plc.write_coil(0, True)
    assert_type(await plc.for_unit(3, timeout=0.3).read_coils(0, 8), list[bool])
    for key, read in (await plc.read_many({"level": ("coils", 0, 8)})).items():
        assert_type(key, str)
        assert_type(read, list[bool])
    async for values in plc.watch(Path("meter.toml"), every=0.5, names=["level"]):
        assert_type(values, PolledValues)
        assert_type(values.fell, frozenset[str])
        assert_type(values.failed, dict[str, ModbusError])
    async with plc as same:
        assert_type(same, AsyncClient)


def told_of(access: Access) -> None:
    assert_type(access.address, int)


def serving() -> None:
    mapping = Mapping(coils=64, discrete_inputs=range(10, 20))
    mapping.holding_registers[100:104] = [1, 2, 3, 4]
    assert_type(mapping.holding_registers[100], int)
    mapping.holding_registers.write(100, 3.14, "float32", order="CDAB")
    Mapping(holding_registers=[range(10), range(100, 110)])
    Mapping(holding_registers={100: [555, 0, 100]}, coils={0: [True]})
    Server({1: Device(mapping), 2: Device(Mapping(coils=8))}, unknown_unit="silent")
    Device(mapping, before_read=Hook(told_of, input_registers=range(100)), after_write=print)
    Device(mapping, before_write=Hook(told_of, coils=[range(8)], files=[range(1, 3)]))
    Server(Device(mapping), trace=print).serve_forever("tcp://127.0.0.1:1502")


def passing_on() -> None:
    routes = [
        Route("rtu:///dev/ttyUSB0?baudrate=9600", "1-10", cache=1.0, merge=True),
        Route("tcp://192.0.2.10", [20], device_units=1, writable=["coils"]),
    ]
    with Gateway(routes, own_units=[255], writes_first=True).background("tcp://127.0.0.1:0"):
        pass


def hearing() -> None:
    with listen("rtu:///dev/ttyUSB0", capture="line.pcapng") as line:
        for entry in line:
            assert_type(entry, Transaction)
    assert_type(Separator("ascii").feed(b"", 0.0, "client"), list[Transaction])


async def hearing_in_a_loop() -> None:
    async with listen("rtu+tcp://:1502", between="rtu+tcp://192.0.2.10") as line:
        async for entry in line:
            assert_type(entry, Transaction)
