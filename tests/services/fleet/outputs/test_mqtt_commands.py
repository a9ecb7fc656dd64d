"""
Commands over MQTT with a real broker: which are taken, and who answers.
"""

from __future__ import annotations

from tests.services.fleet.fleets import until
from tests.services.fleet.outputs.brokers import Broker, commanded, publish, run


def test_names_are_taken_in_one_spelling_only(broker: Broker) -> None:
    """A broker that denies modbus/a/+/set does not know that %61 is the same."""

    async def go() -> None:
        async with commanded(broker, commands=True) as (_, heard, device):
            for names in ("%61/setpoint", "a/set%70oint", "a/%2f", "a/%FF"):
                await publish(broker, f"modbus/{names}/set", b"21")
            await publish(broker, "modbus/a/setpoint/set", b"22")
            await until(lambda: heard)
            assert [topic for topic, _, _ in heard] == ["modbus/a/setpoint/set/result"]
            assert device.mapping.holding_registers[2] == 22

    run(go())
