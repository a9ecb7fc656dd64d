"""Register maps bound to clients: values as attributes, read and written with both clients."""

import asyncio
import copy
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, Device, ModbusTimeoutError, Point, RegisterMap, Server
from libmodbus_py.serve import Fault
from tests.support.cases import each_case

MAP = RegisterMap(
    [
        Point("voltage L1", "input_registers", 0, scale=0.1),
        Point("setpoint", "holding_registers", 0, scale=0.1, minimum=5),
        Point("read", "coils", 0),
        Point("key", "coils", 1, access="write"),
    ]
)


def device() -> Device:
    return Device.of_map(MAP, {"voltage L1": 230.5, "setpoint": 20})


def test_a_bound_map_reads_and_writes_with_a_blocking_client() -> None:
    device_ = device()
    with Server(device_).background("tcp://127.0.0.1:0") as running, Client(running.urls[0]) as plc:
        meter = MAP.bind(plc, gap=4)
        assert meter.read() is None
        assert (meter.voltage_L1, meter.setpoint, meter.read_) == (230.5, 20, False)
        assert meter["voltage L1"] == 230.5
        assert meter.write(setpoint=21.5, read_=True, key=True) is None
        assert (device_["setpoint"], device_["read"], device_["key"]) == (21.5, True, True)
        assert meter.setpoint == 20
        meter.read("setpoint")
        assert meter.setpoint == 21.5
        assert {"voltage_L1", "setpoint", "read_", "read", "write"} <= set(dir(meter))


async def test_a_bound_map_reads_and_writes_with_an_asyncio_client() -> None:
    device_ = device()
    async with (
        Server(device_).serving("tcp://127.0.0.1:0") as running,
        AsyncClient(running.urls[0]) as plc,
    ):
        meter = MAP.bind(plc)
        await meter.read()
        assert meter.voltage_L1 == 230.5
        await meter.write(setpoint=21.5)
        assert (device_["setpoint"], meter.setpoint) == (21.5, 20)
        await asyncio.gather(meter.read("setpoint"), meter.read("read_"))
        assert meter.setpoint == 21.5
        reading = asyncio.ensure_future(meter.read())
        await asyncio.sleep(0)
        reading.cancel()
        with pytest.raises(asyncio.CancelledError):
            await reading
        await meter.read()


def test_a_failed_read_leaves_all_values_as_they_were() -> None:
    faults = [Fault("no_answer", function=1)]
    server = Server(device(), faults={None: []})
    with (
        server.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], timeout=0.2) as plc,
    ):
        meter = MAP.bind(plc)
        meter.read()
        server.replace(Device.of_map(MAP, {"voltage L1": 99}), faults={None: faults})
        with pytest.raises(ModbusTimeoutError):
            meter.read()
        assert meter.voltage_L1 == 230.5


class NoClient:
    """An object that is no client, and must not be used."""

    def read_map(self, *_: Any, **__: Any) -> Any:
        raise AssertionError

    write_map = read_map


@each_case(
    ("use", "error", "message"),
    [
        (
            lambda meter: meter.setpoint,
            AttributeError,
            r"setpoint has not been read: call read\(\)",
        ),
        (lambda meter: meter.sepoint, AttributeError, "'sepoint'; did you mean setpoint"),
        (lambda meter: meter.read("sepoint"), AttributeError, "'sepoint'; did you mean"),
        (lambda meter: meter.read("voltage L1"), AttributeError, "did you mean voltage_L1"),
        (lambda meter: meter.write(sepoint=3), AttributeError, "'sepoint'; did you mean"),
        (lambda meter: meter["setpoint"], KeyError, "has not been read"),
        (lambda meter: meter["setpint"], KeyError, "did you mean setpoint"),
        (lambda meter: setattr(meter, "setpoint", 3), AttributeError, r"write\(setpoint=...\)"),
        (lambda meter: meter._nothing, AttributeError, "_nothing"),
    ],
)
def test_wrong_names_are_refused_before_anything_is_sent(use, error, message) -> None:
    with pytest.raises(error, match=message):
        use(MAP.bind(NoClient()))


def test_an_object_that_is_no_client_is_refused() -> None:
    with pytest.raises(TypeError, match="client must be a client, not str"):
        MAP.bind("tcp://192.0.2.10")  # type: ignore[arg-type]


def test_a_copy_of_a_bound_map_keeps_its_values() -> None:
    meter = MAP.bind(NoClient())
    meter._values["setpoint"] = 3
    assert copy.copy(meter).setpoint == 3
