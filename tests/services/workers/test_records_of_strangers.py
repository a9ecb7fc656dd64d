"""
Records that any program may have written to the bucket: no worker ends, and commands are answered.
"""

from __future__ import annotations

import json

import pytest

from libmodbus_py.services.workers import records
from libmodbus_py.services.workers.records import FleetSettings, RecordError, decode, digest_of
from tests.services.workers.trial import LEASE, Trial

KEY = "tcp:192.0.2.99:502"


@pytest.mark.parametrize(
    "devices",
    [[], 7, {}, {"devices": 7}, {"devices": [7, None, {"name": {}}], "maps": []}],
    ids=str,
)
def test_devices_in_any_form_cost_no_answer_and_no_poll(devices: object) -> None:
    trial = Trial(2, settings=FleetSettings(LEASE, commands=True))

    async def main() -> None:
        await trial.start("a", "b")
        await trial.settle()
        value = {"connection": KEY, "timeout": 0.1, "devices": devices}
        trial.engine.write(f"connection._.{digest_of(KEY)}", json.dumps(value).encode())
        await trial.settle()
        client = trial.engine.client()
        answer = await client.request("modbus.write.nobody.setpoint", b"20", timeout=5)
        assert json.loads(answer.data)["error"] == "there is no device 'nobody'"
        await client.close()

    trial.run(main)


def test_a_mistake_of_a_reader_is_one_of_the_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else all workers would end one after the other, at the same record."""

    def fail(rest: object, given: object) -> None:
        raise OverflowError("too large")

    monkeypatch.setitem(records._READERS, ("settings", 0), fail)  # type: ignore[arg-type]
    with pytest.raises(RecordError, match="settings: too large"):
        decode("settings", b"{}")
