"""
Contexts against the server of this package, over every transport.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Context, IllegalDataAddress, Mapping
from libmodbus_py.client.blocking import Client

UNIT = 17


@pytest.fixture
def context(url: str) -> Iterator[Context]:
    with Context.from_url(url, unit=UNIT) as made:
        yield made


class TestEveryTransport:
    """Once and twice: the first answer is checked here, the second comes through libmodbus."""

    @pytest.fixture(autouse=True, params=[1, 2])
    def times(self, request: pytest.FixtureRequest) -> range:
        return range(request.param)

    def test_reads(self, context: Context, times: range) -> None:
        for _ in times:
            coils = [True, False, True, True, False, False, True, True, True, False]
            assert context.read_coils(10, 10) == coils
            assert context.read_discrete_inputs(20, 3) == [False, True, False]
            assert context.read_holding_registers(100, 3) == [1000, 1001, 1002]
            assert context.read_input_registers(200, 2) == [2000, 2001]

    def test_writes(self, context: Context, mapping: Mapping, times: range) -> None:
        for turn in times:
            context.write_coil(11, True)
            context.write_coils(30, [True, False, True])
            context.write_register(101, 40000 + turn)
            context.write_registers(110, [1, 2, 65535])
            assert mapping.coils[11]
            assert mapping.coils[30:33] == [True, False, True]
            assert mapping.holding_registers[101] == 40000 + turn
            assert mapping.holding_registers[110:113] == [1, 2, 65535]

    def test_refusal_names_what_was_asked(self, context: Context, times: range) -> None:
        for _ in times:
            with pytest.raises(IllegalDataAddress) as caught:
                context.read_holding_registers(399, 2)
            error = caught.value
            assert (error.unit, error.function, error.code) == (UNIT, 3, 2)
            assert "ReadHoldingRegisters(address=399, count=2)" in str(error)
            assert error.sent
            assert error.received


def test_a_client_is_a_context_for_any_url(url: str) -> None:
    with Client(url, unit=UNIT, timeout=2) as client:
        assert isinstance(client, Context)
        assert client.read_holding_registers(100, 3) == [1000, 1001, 1002]
        assert (client.unit, client.timeout) == (UNIT, 2)
        assert client.url == Context.from_url(url).url
        assert repr(client) == f"<Client {client.url}, unit {UNIT}, connected>"


@pytest.mark.parametrize(
    ("url", "options", "settings"),
    [
        ("rtu:///dev/ttyS0?baudrate=9600", {"parity": "N"}, "parity=N"),
        ("ascii:///dev/ttyS0?unit=7", {"data_bits": 8, "timeout": 0.5}, "data_bits=8"),
    ],
)
def test_a_client_takes_the_settings_of_serial_ports(
    url: str, options: dict[str, Any], settings: str
) -> None:
    client = Client(url, **options)
    assert settings in client.url
    assert client.url == Context.from_url(url, **options).url


@pytest.mark.parametrize(
    ("url", "options", "error"),
    [
        ("http://192.0.2.1", {}, ValueError),
        ("tcp://192.0.2.1", {"unti": 1}, TypeError),
        ("tcp://192.0.2.1", {"parity": "N"}, TypeError),
        (5, {}, TypeError),
    ],
)
def test_a_client_refuses_what_is_wrong(url: Any, options: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        Client(url, **options)
