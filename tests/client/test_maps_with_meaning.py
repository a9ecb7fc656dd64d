"""Maps whose points have scales of the device, or are parts of registers: what clients ask."""

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    IllegalFunction,
    Mapping,
    NoValue,
    Point,
    RegisterMap,
    Server,
    ServerDeviceBusy,
    pdu,
)

H = "holding_registers"


def point(name: str, address: int, **keys: Any) -> Point:
    return Point(name, H, address, **keys)


POINTS = RegisterMap(
    [
        point("v", 0, type="int16", scale_from="v_sf"),
        point("v_sf", 1, type="int16"),
        *(point(f"b{at}", 2, bit=at) for at in range(16)),
        point("none", 3, missing=0),
    ]
)


def refuse(error: type[Exception]) -> Any:
    def handler(*arguments: Any) -> Any:
        raise error("not here")

    return handler


def device(**options: Any) -> Device:
    return Device(Mapping(holding_registers={0: [2305, 0xFFFF, 0xFF00, 0]}), **options)


@pytest.fixture(params=[False, True], ids=["with 22", "without 22"])
def served(request: pytest.FixtureRequest) -> Iterator[tuple[Device, str]]:
    options = (
        {"handlers": {pdu.MaskWriteRegister: refuse(IllegalFunction)}} if request.param else {}
    )
    device_ = device(**options)
    with Server(device_).background("tcp://127.0.0.1:0") as serving:
        yield device_, serving.urls[0]


def test_values_are_read_and_written_with_the_scale_of_the_device(served: tuple[Device, str]):
    device_, url = served
    with Client(url) as plc:
        assert plc.read_map(POINTS, ["v", "none"]) == {"v": 230.5, "none": None}
        value = plc.read_map(POINTS, ["none"], return_exceptions=True)["none"]
        assert isinstance(value, NoValue)
        plc.write_map(POINTS, {"v": 12.5})
        assert device_.mapping.holding_registers[0] == 125
        device_.mapping.holding_registers[1] = 300
        with pytest.raises(NoValue, match="v_sf, which scales it, must hold a power"):
            plc.write_map(POINTS, {"v": 1})


def test_a_part_of_a_register_is_written(served: tuple[Device, str]) -> None:
    device_, url = served
    with Client(url) as plc:
        plc.write_map(POINTS, {"b0": True, "b8": False})
    assert device_.mapping.holding_registers[2] == 0xFE01


def test_parts_that_are_written_at_the_same_time_are_all_written(served: tuple[Device, str]):
    device_, url = served

    async def go() -> None:
        async with AsyncClient(url) as plc:
            await asyncio.gather(*(plc.write_map(POINTS, {f"b{at}": True}) for at in range(8)))

    asyncio.run(go())
    assert device_.mapping.holding_registers[2] == 0xFFFF


def test_a_refusal_of_a_masked_write_other_than_exception_1_is_raised() -> None:
    device_ = device(handlers={pdu.MaskWriteRegister: refuse(ServerDeviceBusy)})
    with Server(device_).background("tcp://127.0.0.1:0") as serving:
        plc = Client(serving.urls[0])
        with plc, pytest.raises(ServerDeviceBusy):
            plc.write_map(POINTS, {"b0": True})
    assert device_.mapping.holding_registers[2] == 0xFF00


TWO = RegisterMap([point("one", 2, bit=0), point("other", 3, bit=1)])


def test_parts_of_several_registers_are_written_by_one_call(served: tuple[Device, str]) -> None:
    device_, url = served

    async def go() -> None:
        async with AsyncClient(url) as plc:
            calls = [plc.write_map(TWO, {"one": True, "other": True}) for _ in range(3)]
            await asyncio.wait_for(asyncio.gather(*calls), 5)

    asyncio.run(go())
    assert device_.mapping.holding_registers[2:4] == [0xFF01, 2]


@pytest.mark.parametrize("served", [True], indirect=True)
@pytest.mark.parametrize("at", range(10))
def test_a_cancelled_write_of_parts_delays_no_other(served, at) -> None:
    """Cancelled at any trace of its frames: another task, or thread, may write registers then."""
    device_, url = served
    calls = iter(range(1000))

    async def go() -> None:
        def leave(_: object) -> None:
            if next(calls) == at:
                task.cancel()

        async with AsyncClient(url, trace=leave) as plc:
            task = asyncio.create_task(plc.write_map(TWO, {"one": True, "other": True}))
            await asyncio.wait([task])
            await asyncio.wait_for(plc.write_map(TWO, {"other": True}), 5)

    def interrupt(_: object) -> None:
        if next(calls) == at:
            raise KeyboardInterrupt

    asyncio.run(go())
    calls = iter(range(1000))
    with Client(url, trace=interrupt) as client:
        with contextlib.suppress(KeyboardInterrupt):
            client.write_map(TWO, {"one": True, "other": True})
        thread = threading.Thread(target=client.write_map, args=(TWO, {"other": True}))
        thread.start()
        thread.join(5)
        assert not thread.is_alive()
    assert device_.mapping.holding_registers[3] == 2
