"""The fixtures of the pytest plugin, as tests get them: these are tests that do."""

import logging
from collections.abc import Iterator

import pytest

from libmodbus_py import (
    Client,
    Device,
    Fault,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    ServerDeviceBusy,
)
from libmodbus_py.server.faults import FaultSwitch
from libmodbus_py.tools.testing.recording import RecordingServer, ServerMaker
from libmodbus_py.tools.testing.wires import SerialWire

SILENT = Fault("no_answer")
BUSY = Fault("exception", code=6)


@pytest.fixture
def quiet(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """No warning may be logged until the end."""
    with caplog.at_level(logging.WARNING):
        yield
    assert caplog.get_records("call") + caplog.get_records("teardown") == []


class TestServer:
    @pytest.mark.parametrize("time", [1, 2])
    def test_each_test_gets_a_new_server(self, modbus_server: RecordingServer, time):
        assert modbus_server.transactions == []
        with Client(f"tcp://{modbus_server.host}:{modbus_server.port}", unit=247) as client:
            for unit in (1, 247):
                handle = client.for_unit(unit)
                assert handle.read_coils(65535, 1) == handle.read_discrete_inputs(65535, 1)
                assert handle.read_input_registers(65535, 1) == [0]
            assert client.read_holding_registers(65535, 1) == [0]
            client.write_register(65535, 99)
        assert modbus_server.mapping.holding_registers[65535] == 99

    def test_the_server_is_one_object_for_all_fixtures_of_a_test(
        self, modbus_server: RecordingServer, modbus_faults: FaultSwitch
    ) -> None:
        assert modbus_server.faults is modbus_faults
        assert modbus_server.device is not None
        assert modbus_server.device.mapping is modbus_server.mapping
        assert modbus_server.url == f"tcp://127.0.0.1:{modbus_server.port}"

    def test_old_transactions_are_dropped(self, make_modbus_server: ServerMaker, monkeypatch):
        monkeypatch.setattr("libmodbus_py.tools.testing.recording.MOST", 4)
        server = make_modbus_server()
        with Client(server.url) as client:
            for count in range(1, 6):
                client.read_coils(0, count)
        assert [item.response for item in server.transactions] == [[False] * 4, [False] * 5]


class TestMaker:
    @pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp"])
    def test_any_endpoint_is_recorded(self, make_modbus_server: ServerMaker, scheme: str) -> None:
        server = make_modbus_server(f"{scheme}://127.0.0.1:0")
        with Client(server.url, unit=3) as client:
            client.write_coils(8, [True, False, True])
        (write,) = server.transactions
        assert str(write) == "unit 3: WriteCoils(address=8, values=(True, False, True)) -> done"

    def test_a_server_has_several_devices(self, make_modbus_server: ServerMaker) -> None:
        devices = {1: Device(Mapping(8)), 2: Device(Mapping(16))}
        server = make_modbus_server(
            "tcp://127.0.0.1:0",
            "rtu+tcp://127.0.0.1:0",
            devices=devices,
            faults={2: [BUSY]},
            unknown_unit="silent",
        )
        assert server.url == server.urls[0]
        assert server.device is None
        with pytest.raises(AttributeError, match="several devices"):
            _ = server.mapping
        for url in server.urls:
            with Client(url, timeout=0.2) as client:
                assert client.read_coils(7, 1) == [False]
                with pytest.raises(ServerDeviceBusy):
                    client.for_unit(2).read_coils(15, 1)
                with pytest.raises(ModbusTimeoutError):
                    client.for_unit(3).read_coils(0, 1)
        assert [transaction.kind for transaction in server.transactions] == [
            *("answered", "exception", "unanswered"),
            *("answered", "exception", "unanswered"),
        ]

    def test_a_server_can_be_closed_before_the_end(self, make_modbus_server: ServerMaker) -> None:
        device = Device(Mapping(8))
        server = make_modbus_server(devices={7: device})
        assert server.device is device
        with Client(server.url, unit=7) as client:
            client.read_coils(0, 1)
            server.close()
            server.close()
            with pytest.raises(ModbusConnectionError):
                client.read_coils(0, 1)
        assert len(server.transactions) == 1
        server.faults.switch_on(SILENT).switch_off()


class TestSerialLine:
    @pytest.mark.parametrize("framing", ["rtu", "ascii"])
    def test_a_serial_server_uses_one_end_of_a_line_and_stops_before_it(
        self, quiet: None, make_modbus_server: ServerMaker, modbus_serial_line: SerialWire, framing
    ) -> None:
        server = make_modbus_server(f"{framing}://{modbus_serial_line.server}")
        assert (server.host, server.port) == ("", 0)
        with Client(f"{framing}://{modbus_serial_line.client}", unit=9) as client:
            assert client.read_coils(0, 1) == [False]
            client.for_unit(0).write_coil(0, True)
        assert len(modbus_serial_line.sent_by("client")) > 8
        assert [item.kind for item in server.transactions] == ["answered", "broadcast"]
