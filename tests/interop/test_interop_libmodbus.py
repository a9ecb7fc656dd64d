"""
Against libmodbus itself, in C: its server, its client, and the example programs
of Debian's libmodbus-dev.
"""

import contextlib
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, IllegalFunction, Mapping, ModbusTimeoutError, pdu
from libmodbus_py.low_level import loaded_version
from libmodbus_py.ports.endpoint import Endpoint
from tests.support.c_programs import compile_c
from tests.support.interop import (
    BAUDRATE,
    TIMEOUT,
    UNIT,
    Exchange,
    Record,
    c_serving,
    call,
    case_id,
    cells,
    check_answers,
    check_refusals,
    coil,
    connected,
    exchanges,
    holding_register,
    make_device,
    of_a_client,
    our_server,
    program,
    try_cases,
)

EXAMPLES = Path("/usr/share/doc/libmodbus-dev/examples")
TRANSPORTS = ("tcp", "rtu")

each_transport = pytest.mark.parametrize("transport", TRANSPORTS)


@contextlib.contextmanager
def c_server(server: Path, transport: str, **options: Any) -> Iterator[Client]:
    """Yield a client of ours that is connected to the C server."""
    with c_serving(server, transport) as url, connected(url, **options) as context:
        yield context


def who_it_is() -> Iterator[Exchange]:
    version = ".".join(map(str, loaded_version()))
    answer = pdu.ServerId(b"\xb4", True, f"LMB{version}".encode())
    yield Exchange(17, "id", lambda c: c.report_server_id(), answer)


@each_transport
def test_context_and_c_server_agree(
    compiled: Callable[[str], Path], transport: str, record_property: Record
) -> None:
    with c_serving(compiled("server"), transport) as url:
        check_answers(url, "libmodbus", [*exchanges(), *who_it_is()], record_property)


@each_transport
def test_context_raises_what_c_server_refuses(
    compiled: Callable[[str], Path], transport: str, record_property: Record
) -> None:
    with c_serving(compiled("server"), transport) as url:
        check_refusals(url, "libmodbus", record_property)


LACKING: dict[int, Callable[[Client], object]] = {
    7: call("read_exception_status"),
    8: call("diagnostics", 0, 0xA537),
    11: call("read_comm_event_counter"),
    12: call("read_comm_event_log"),
    20: call("read_file_records", [(4, 0, 2)]),
    21: call("write_file_records", [(4, 0, [1])]),
    24: call("read_fifo_queue", 100),
    43: call("read_device_identification"),
}
"""Functions that libmodbus does not have."""

PATIENCE = {"refused": TIMEOUT, "pinned": 0.2}


def what_it_lacks(transport: str) -> Iterator[Exchange]:
    """Yield each request that libmodbus lacks, with its possible errors."""
    for function, ask in LACKING.items():
        if function == 7:
            # modbus_reply names it, and does nothing with it: "FIXME Not implemented" in 3.1.6;
            # newer ones refuse it as they should.
            yield Exchange(function, "pinned", ask, (ModbusTimeoutError, IllegalFunction))
        elif transport == "rtu" and function not in (11, 12):
            # It thinks that a request of a code which it does not know is the code alone: it takes
            # the two bytes after that for the CRC, finds it wrong, and says nothing.
            yield Exchange(function, "pinned", ask, ModbusTimeoutError)
        else:
            # Over TCP, it reads one byte of such a request, answers after its response timeout of
            # half a second, and throws the rest away: in step again.
            look = call("read_holding_registers", 100, 1)
            yield Exchange(function, "refused", ask, IllegalFunction, look, [1100])


@each_transport
def test_what_libmodbus_lacks_is_refused_or_not_answered(
    compiled: Callable[[str], Path], transport: str, record_property: Record
) -> None:
    cases = of_a_client("libmodbus", transport, what_it_lacks(transport))
    for check, exchange in try_cases(record_property, cases):
        patience = PATIENCE[exchange.name]
        with check, c_server(compiled("server"), transport, timeout=patience) as context:
            errors: Any = exchange.answer
            with pytest.raises(errors) as caught:
                exchange.ask(context)
            assert caught.value.function == exchange.function
            assert exchange.look(context) == exchange.seen


def test_c_server_obeys_a_broadcast_in_silence(compiled: Callable[[str], Path]) -> None:
    with c_server(compiled("server"), "rtu", turnaround=0.05) as context:
        context.for_unit(0).write_registers(100, [1, 2])
        assert context.read_holding_registers(100, 3) == [1, 2, 1102]


C_CLIENT_CALLS = (1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23)
C_CLIENT_REFUSALS = tuple(code for code in C_CLIENT_CALLS if code != 17)


def run_c_client(client: Path, end: Endpoint) -> set[str]:
    """Return the lines that the client prints; a client that hangs is ended."""
    where = [end.path, BAUDRATE] if end.is_serial else [end.port]
    command = (client, end.scheme, *where, UNIT)
    with program(*command) as process, contextlib.suppress(subprocess.TimeoutExpired):
        return set(process.communicate(timeout=20)[0].splitlines())
    return set()


@pytest.fixture(scope="module")
def c_client_runs(compiled: Callable[[str], Path]) -> Callable[[str], tuple[set[str], Device]]:
    """Return the lines that the C client printed over a transport, and its device afterwards."""
    runs: dict[str, tuple[set[str], Device]] = {}

    def run(transport: str) -> tuple[set[str], Device]:
        if transport not in runs:
            device = make_device()
            with our_server(transport, {UNIT: device}) as place:
                runs[transport] = (run_c_client(compiled("client"), place.end), device)
        return runs[transport]

    return run


@each_transport
def test_a_c_client_and_our_server_agree(
    c_client_runs: Callable[[str], tuple[set[str], Device]], transport: str, record_property: Record
) -> None:
    output, _ = c_client_runs(transport)
    executed = [
        (case_id("libmodbus", "server", transport, function), f"FC {function} ok")
        for function in C_CLIENT_CALLS
    ]
    refusals = [
        (case_id("libmodbus", "server", transport, function, "refused"), f"FC {function} refused")
        for function in C_CLIENT_REFUSALS
    ]
    for check, line in try_cases(record_property, executed + refusals):
        with check:
            assert line in output


@each_transport
def test_a_c_client_writes_into_our_mapping(
    c_client_runs: Callable[[str], tuple[set[str], Device]], transport: str
) -> None:
    _, device = c_client_runs(transport)
    coils = device.mapping.coils
    assert coils[10:1978] == [not value for value in cells(coil, 10, 1968)]
    assert coils[1978:2109] == cells(coil, 1978, 131)
    assert coils[2109] is True
    registers = device.mapping.holding_registers
    assert registers[100:223] == [3 * address for address in range(100, 223)]
    assert registers[223:250] == cells(holding_register, 223, 27)
    assert registers[250] == 0xA5EF
    assert registers[270:391] == [3 * address for address in range(270, 391)]
    assert registers[391:400] == [*cells(holding_register, 391, 8), 65535]


@pytest.mark.parametrize("transport", TRANSPORTS)
@pytest.mark.parametrize(
    "server_id",
    [
        pdu.ServerId(b"\x2a", False),
        pdu.ServerId(b"\x2a", True, bytes(range(249))),  # as many bytes as fit into a message
    ],
    ids=["least", "most"],
)
def test_identifier_is_the_same_on_every_transport(transport: str, server_id: pdu.ServerId) -> None:
    device = make_device()
    device.server_id = server_id
    with our_server(transport, {UNIT: device}) as place, connected(str(place.end)) as context:
        assert context.report_server_id() == server_id


EXAMPLE_PORT = re.compile(r'modbus_new_tcp\("127\.0\.0\.1", 1502\)')
EXAMPLE_CODES = (1, 3, 5, 6, 15, 16, 23)


def compile_example(name: str, port: int, directory: Path) -> Path:
    """Compile an example that has its port in the source, with another port."""
    source = EXAMPLES / f"{name}.c"
    if not source.exists():
        pytest.skip(f"{source} is not there: this system installs no documentation")
    text, count = EXAMPLE_PORT.subn(
        f'modbus_new_tcp("127.0.0.1", {port})', source.read_text(encoding="utf-8")
    )
    assert count == 1
    copy = directory / source.name
    copy.write_text(text, encoding="utf-8")
    return compile_c(copy, directory / name)


def test_example_client_reports_success_against_our_server(tmp_path: Path) -> None:
    # It reads back what it writes: bits and registers at 0..98, 99 rounds of nine
    # requests. It sets no unit, and so asks unit 255.
    device = Device(Mapping(coils=100, holding_registers=100))
    with our_server("tcp", device) as place:
        client = compile_example("random-test-client", place.end.port, tmp_path)
        process = subprocess.run([client], capture_output=True, text=True, timeout=30)
        codes = {frame.data[7] for frame in place.wire.passed if frame.sender == "client"}
    assert "Test: SUCCESS" in process.stdout.splitlines()
    assert "ERROR" not in process.stdout
    assert process.returncode == 0
    assert codes == set(EXAMPLE_CODES)
