"""The backend of modbus-connection: its operations over everything, its errors, what it counts."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.protocol.framing import crc16
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.peers import FakeServer, FakeUnit, echo, mbap, refusing
from tests.support.scripted import run

theirs: Any = pytest.importorskip(
    "modbus_connection", reason="the backend of modbus-connection needs Python 3.12"
)

backend: Any = pytest.importorskip("libmodbus_py.services.integrations.modbus_connection")

HOST = "127.0.0.1"
LONG, SHORT = 5.0, 0.2

Ask = Callable[[Any], Coroutine[Any, Any, Any]]


async def call(connection: Any, ask: Ask) -> Any:
    """The answer of unit 1, or the error."""
    try:
        return await ask(connection.for_unit(1))
    except theirs.ModbusError as error:
        return error
    finally:
        await connection.close()


def seven(unit: Any) -> Any:
    return unit.read_holding_registers(7, 1)


def tcp(port: int, timeout: float = LONG) -> Any:
    return backend.ModbusConnection(theirs.ModbusTcpParams(host=HOST, port=port), timeout=timeout)


def device() -> Device:
    mapping = Mapping(
        coils={0: [True, False, True]},
        discrete_inputs={0: [False, True, True]},
        holding_registers={0: [555, 0, 100]},
        input_registers={0: [555, 777]},
    )
    return Device(mapping, files={4: [0, 42, 256]}, fifos={7: [440, 4740]})


# One after the other: what is written is read.
OPERATIONS: list[tuple[Ask, Any]] = [
    (lambda u: u.read_coils(0, 3), [True, False, True]),
    (lambda u: u.read_discrete_inputs(0, 3), [False, True, True]),
    (lambda u: u.read_holding_registers(0, 3), [555, 0, 100]),
    (lambda u: u.read_input_registers(address=0, count=2), [555, 777]),
    (lambda u: u.write_coil(1, True), None),
    (lambda u: u.write_coils(0, [False, True]), None),
    (lambda u: u.read_coils(0, 3), [False, True, True]),
    (lambda u: u.write_register(0, 0x12), None),
    (lambda u: u.mask_write_register(0, 0xF2, 0x25), None),
    (lambda u: u.read_holding_registers(0, 1), [0x17]),  # the specification's example
    (lambda u: u.write_registers(1, [4, 5]), None),
    (lambda u: u.read_write_registers(0, 3, 2, [6]), [0x17, 4, 6]),
    (lambda u: u.read_file_record(4, 1, 2), [42, 256]),
    (lambda u: u.write_file_record(4, 2, [9]), None),
    (lambda u: u.read_file_record(file=4, record=2, length=1), [9]),
    (lambda u: u.read_fifo_queue(7), [440, 4740]),
    (lambda u: u.read_exception_status(), 0),
    (lambda u: u.diagnostics(0, 0xA537), 0xA537),
]

WAYS: dict[str, Callable[[Any], Any]] = {
    "tcp": lambda at: backend.connect_tcp(HOST, port=at),
    "udp": lambda at: backend.connect_udp(HOST, port=at),
    "rtu+tcp": lambda at: backend.connect_serial(f"socket://{HOST}:{at}"),
    "rtu+udp": lambda at: backend.connect_udp(HOST, port=at, framer="rtu"),
    "ascii+tcp": lambda at: backend.connect_serial(f"socket://{HOST}:{at}", framer="ascii"),
    "rtu": lambda at: backend.connect_serial(at, baudrate=115_200),
    "ascii": lambda at: backend.connect_serial(at, bytesize=7, baudrate=115_200, framer="ascii"),
}


async def all_operations(connecting: Any) -> list[Any]:
    connection = await connecting
    try:
        unit = connection.for_unit(1)
        assert isinstance(unit, theirs.ModbusUnit)
        assert unit.connected
        return [await ask(unit) for ask, _ in OPERATIONS]
    finally:
        await connection.close()


@pytest.mark.parametrize("kind", WAYS)
def test_every_operation_works_over_every_transport(kind: str) -> None:
    with contextlib.ExitStack() as stack:
        at: Any = None
        where = f"{kind}://{HOST}:0"
        if kind in ("rtu", "ascii"):
            wire = stack.enter_context(SerialWire())
            at, where = wire.client, f"{kind}://{wire.server}"
        running = stack.enter_context(Server(device()).background(where))
        at = at or int(running.urls[0].rpartition(":")[2])
        assert run(all_operations(WAYS[kind](at))) == [answer for _, answer in OPERATIONS]


# Data of function 17 -> the identifier in it.
IDENTIFIERS = {
    b"\x11\xff": b"\x11",
    b"\xb4\xff3.1.6": b"\xb4",
    b"PUMP\x00abc": b"PUMP",
    b"\x00\x00": b"\x00",
    b"ACME": b"ACME",  # no run indicator
}


@pytest.mark.parametrize(("data", "identifier"), IDENTIFIERS.items())
def test_the_server_id_ends_before_the_run_indicator(data: bytes, identifier: bytes) -> None:
    with FakeServer(lambda r: [mbap(r, bytes([0x11, len(data)]) + data)]) as server:
        assert run(call(tcp(server.port), lambda u: u.report_server_id())) == identifier


# Answer to a read of one register -> what becomes of it, whether the link stays, and the message.
ERRORS: dict[str, tuple[Callable[[bytes], list[bytes]], str, bool, str]] = {
    "refused": (
        lambda r: [mbap(r, b"\x83\x02")],
        "IllegalDataAddressError",
        True,
        "illegal data address",
    ),
    "busy": (lambda r: [mbap(r, b"\x83\x06")], "ServerDeviceBusyError", True, "busy"),
    "unheard": (lambda r: [mbap(r, b"\x83\x63")], "ModbusExceptionError", True, "99"),
    "silent": (lambda r: [], "ModbusTimeoutError", True, "no answer within 0.2 s"),
    "short": (lambda r: [mbap(r, b"\x03\x04\0\1")], "ModbusProtocolError", True, "answered with"),
    "function": (lambda r: [mbap(r, b"\x04\x02\0\7")], "ModbusDesyncError", False, "04 02 00 07"),
    "unit": (lambda r: [echo(r, unit=9)], "ModbusDesyncError", False, "unit 9 answered"),
    "id": (lambda r: [echo(r, transaction=999)], "ModbusDesyncError", False, "id 999, not "),
    "protocol": (lambda r: [echo(r, protocol=7)], "ModbusProtocolError", True, "protocol"),
    "no frame": (lambda r: [b"\xff" * 300], "ModbusProtocolError", False, ""),
}


@pytest.mark.parametrize(("answer", "name", "stays", "text"), ERRORS.values(), ids=ERRORS)
def test_errors_have_the_specified_classes(answer: Any, name: str, stays: bool, text: str) -> None:
    async def go() -> None:
        connection = tcp(server.port, SHORT)
        try:
            with pytest.raises(theirs.ModbusError) as caught:
                await seven(connection.for_unit(1))
            assert type(caught.value).__name__ == name
            assert str(caught.value).startswith("read_holding_registers(7, 1): unit 1: ")
            assert text in str(caught.value)
            assert connection.last_error == str(caught.value)
            assert connection.connected is stays
            assert len(server.requests) == 1
            assert await seven(connection.for_unit(1)) == [7]
            assert server.connections == (1 if stays else 2)
        finally:
            await connection.close()

    with FakeServer(answer, lambda r: [echo(r)]) as server:
        run(go())


def test_an_answer_of_another_unit_on_a_line_is_dropped() -> None:
    frame = bytes([9, 3, 2, 0, 7])
    with FakeUnit(lambda r: [frame + crc16(frame).to_bytes(2, "little")]) as line:
        connection = backend.ModbusConnection(
            theirs.ModbusSerialParams(device=line.path), timeout=SHORT
        )
        error = run(call(connection, seven))
    assert isinstance(error, theirs.ModbusDesyncError)


WRONG: dict[str, Ask] = {
    "address": lambda u: u.read_coils(65536, 1),
    "count": lambda u: u.read_holding_registers(0, 126),
    "values": lambda u: u.write_registers(0, []),
    "value": lambda u: u.write_register(0, -1),
}


@pytest.mark.parametrize("ask", WRONG.values(), ids=WRONG)
def test_wrong_arguments_stay_value_errors_and_are_not_sent(ask: Ask) -> None:
    with FakeServer(lambda r: [echo(r)]) as server:
        with pytest.raises(ValueError, match="must"):
            run(call(tcp(server.port), ask))
        assert server.requests == []


Make = Callable[[], Any]

PLACES: dict[str, Make] = {
    "tcp://plc.local:502": lambda: theirs.ModbusTcpParams(host="PLC.local"),
    "tcp://[fe80::1%enP2s0]:1502": lambda: theirs.ModbusTcpParams(host="FE80::1%enP2s0", port=1502),
    "rtu+udp://plc:502": lambda: theirs.ModbusUdpParams(host="plc", framer="rtu"),
    "tls://plc:802": lambda: theirs.ModbusTlsParams(host="plc"),
    "ascii+tcp://[::1]:7000": lambda: theirs.ModbusSerialParams(
        device="socket://[::1]:7000", framer="ascii"
    ),
    "rtu:///dev/ttyUSB0?baudrate=19200&data_bits=8&parity=E&stop_bits=1": lambda: (
        theirs.ModbusSerialParams(device="/dev/ttyUSB0", baudrate=19200, parity="E")
    ),
    "rtu:///dev/tty%3F1?baudrate=9600&data_bits=8&parity=N&stop_bits=1": lambda: (
        theirs.ModbusSerialParams(device="/dev/tty?1")
    ),
}


@pytest.mark.parametrize(("url", "make"), PLACES.items(), ids=PLACES)
def test_parameters_give_the_url_of_their_endpoint(url: str, make: Make) -> None:
    assert backend.ModbusConnection(make()).url == url


NOWHERE: dict[str, tuple[Make, str]] = {
    "host": (lambda: theirs.ModbusTcpParams(host="http://plc"), "host 'http://plc'"),
    "query": (lambda: theirs.ModbusTcpParams(host="plc?unit=3"), "host"),
    "empty": (lambda: theirs.ModbusTlsParams(host=""), "host ''"),
    "port": (lambda: theirs.ModbusUdpParams(host="plc", port=70000), "70000"),
    "ascii over udp": (
        lambda: theirs.ModbusUdpParams(host="plc", framer="ascii"),
        "socket, rtu over UDP, not 'ascii'",
    ),
    "relative": (lambda: theirs.ModbusSerialParams(device="ttyUSB0"), "must be a path"),
    "portless": (lambda: theirs.ModbusSerialParams(device="socket://plc"), "socket://HOST:PORT"),
    "other": (lambda: theirs.ModbusSerialParams(device="rfc2217://plc:1"), "socket://HOST:PORT"),
}


@pytest.mark.parametrize(("make", "text"), NOWHERE.values(), ids=NOWHERE)
def test_parameters_of_an_invalid_endpoint_are_refused_at_once(make: Make, text: str) -> None:
    with pytest.raises(ValueError, match=re.escape(text)) as caught:
        backend.ModbusConnection(make())
    assert "\n" not in str(caught.value)


def test_wrong_parameters_times_and_units_are_refused() -> None:
    with pytest.raises(TypeError, match=r"params must be one of ModbusTcpParams, .* not str"):
        backend.ModbusConnection("tcp://192.0.2.10")
    for name in ("timeout", "message_spacing", "connect_delay"):
        with pytest.raises(ValueError, match=f"{name} must be in 0"):
            backend.ModbusConnection(theirs.ModbusTcpParams(host="plc"), **{name: -1})
    connection = tcp(1)
    for unit in (-1, 256):
        with pytest.raises(ValueError, match=r"unit_id must be in 0\.\.255"):
            connection.for_unit(unit)


def test_an_unreachable_device_is_an_error_of_one_line() -> None:
    with refusing() as bound:
        connection = tcp(bound.getsockname()[1])
        error = run(call(connection, seven))
    assert type(error) is theirs.ModbusConnectionError
    assert str(error).startswith("read_holding_registers(7, 1): ")
    assert "refused" in str(error)
    assert connection.last_error == str(error)
    assert connection.statistics.failed_connects == 1


def test_tls_with_certificates_of_both_connects(pki: Pki) -> None:
    own = pki.files(certificates.client())
    with Server(device(), security=pki.server()).background(f"tls://{HOST}:0") as running:
        port = int(running.urls[0].rpartition(":")[2])
        params = theirs.ModbusTlsParams(
            host=HOST,
            port=port,
            verify=str(pki.ca),
            client_cert=str(own.cert),
            client_key=str(own.key),
        )
        connection = backend.ModbusConnection(params, timeout=LONG)
        assert run(call(connection, lambda u: u.read_coils(0, 3))) == [True, False, True]


def test_an_invalid_tls_file_is_named(tmp_path: Path) -> None:
    for options in ({"verify": "/none.pem"}, {"client_cert": "/none.pem"}, {"verify": __file__}):
        params = theirs.ModbusTlsParams(host=HOST, port=1, **options)
        with pytest.raises(ValueError, match=f"cannot use .*{next(iter(options.values()))}"):
            run(call(backend.ModbusConnection(params), seven))


def test_prometheus_metrics_can_be_collected_from_a_connection() -> None:
    client = pytest.importorskip("prometheus_client")
    prometheus = pytest.importorskip("libmodbus_py.services.integrations.prometheus")
    registry = client.CollectorRegistry()
    with FakeServer(lambda r: [echo(r)]) as server:
        connection = tcp(server.port)
        prometheus.collect(connection, registry=registry)
        run(call(connection, seven))
        text = client.generate_latest(registry).decode()
    assert f'modbus_client_responses_total{{endpoint="{server.url}"}} 1.0' in text
