"""The functions of contexts, and the examples of their page."""

import contextlib
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import ExceptionResponse, IllegalDataAddress, InvalidResponse, TcpContext, pdu
from libmodbus_py.low_level import loaded_version
from tests.support import vectors
from tests.support.c_programs import compile_c
from tests.support.cases import each
from tests.support.contexts import AnyContext, context_at
from tests.support.interop import (
    IDENTIFICATION,
    OBJECTS,
    SERVER_ID,
    UNIT,
    c_serving,
    call,
    check_all,
    make_device,
    our_server,
)
from tests.support.peers import TcpPeer, Write, mbap, peer_at

each_transport = pytest.mark.parametrize("transport", ["tcp", "rtu"])

# Function code -> what calls libmodbus's own function, with the fields of the request.
CALLS: dict[int, Callable[[AnyContext, Any], object]] = {
    1: lambda context, asked: context.read_coils(asked.address, asked.count),
    2: lambda context, asked: context.read_discrete_inputs(asked.address, asked.count),
    3: lambda context, asked: context.read_holding_registers(asked.address, asked.count),
    4: lambda context, asked: context.read_input_registers(asked.address, asked.count),
    5: lambda context, asked: context.write_coil(asked.address, asked.value),
    6: lambda context, asked: context.write_register(asked.address, asked.value),
    15: lambda context, asked: context.write_coils(asked.address, asked.values),
    16: lambda context, asked: context.write_registers(asked.address, asked.values),
    17: lambda context, asked: context.report_server_id(),
    22: lambda context, asked: context.mask_write_register(
        asked.address, asked.and_mask, asked.or_mask
    ),
    23: lambda context, asked: context.read_write_registers(
        asked.read_address, asked.read_count, asked.write_address, asked.values
    ),
}


def outcome(act: Callable[[], object]) -> object:
    """Return the result of an action, or the code of its exception."""
    try:
        return act()
    except ExceptionResponse as refusal:
        return refusal.code


@each_transport
def test_contexts_send_and_understand_the_examples_of_the_specification(transport: str) -> None:
    answers: list[vectors.FrameVector] = []

    def answer(request: bytes, write: Write) -> None:
        is_tcp = transport == "tcp"
        write(mbap(request, answers[-1].pdu) if is_tcp else answers[-1].rtu)

    asked_by_libmodbus = 0
    with peer_at(transport, answer) as peer, context_at(peer.url, timeout=2.0) as context:
        for check, (request, response) in each(vectors.exchanges()):
            with check:
                if not 0 < request.unit <= 247 or response.unit != request.unit:
                    continue
                decoded = pdu.decode_request(request.pdu)
                result = outcome(lambda: decoded.decode_response(response.pdu))  # noqa: B023
                context.unit = request.unit
                ways = [lambda: context.execute(decoded)]  # noqa: B023
                if request.function in CALLS:
                    ways.append(lambda: CALLS[request.function](context, decoded))  # noqa: B023
                    asked_by_libmodbus += 1
                for way in ways:
                    answers.append(response)
                    assert outcome(way) == result
                    body = peer.requests[-1][7:] if transport == "tcp" else peer.requests[-1]
                    assert body == (request.pdu if transport == "tcp" else request.rtu)
    assert asked_by_libmodbus > 10


@each_transport
def test_contexts_get_all_values_of_a_server_in_c(compiled: Callable[[str], Path], transport: str):
    with c_serving(compiled("server"), transport) as url, context_at(url) as context:
        check_all(context)  # type: ignore[arg-type]
        version = ".".join(map(str, loaded_version()))
        assert context.report_server_id() == pdu.ServerId(b"\xb4", True, f"LMB{version}".encode())


LACKING: dict[str, tuple[Callable[[Any], object], object]] = {
    "status": (call("read_exception_status"), 0x6D),
    "diagnostics": (call("diagnostics", 0, 0xA537), 0xA537),
    "records": (call("read_file_records", [(4, 1, 2), (3, 9, 2)]), [[5001, 5002], [0x33CD, 0x40]]),
    "writes": (call("write_file_records", [(4, 1, [5001])]), None),
    "queue": (call("read_fifo_queue", 100), [440, 4740]),
    "object": (
        call("read_device_identification", 128),
        pdu.DeviceIdentification(0x83, {128: b"private"}),
    ),
    "identification": (
        call("read_device_identification", "regular"),
        pdu.DeviceIdentification(0x83, {key: OBJECTS[key] for key in (0, 1, 2, 3, 6)}),
    ),
    "server id": (call("report_server_id"), SERVER_ID),
    "own code": (lambda context: outcome(lambda: context.execute(pdu.RawRequest(65, b"ab"))), 1),
}
"""Functions that libmodbus lacks -> what the server of this package answers to them."""


@each_transport
def test_contexts_have_the_functions_that_libmodbus_lacks(transport: str) -> None:
    assert len(IDENTIFICATION) == len(OBJECTS)
    with (
        our_server(transport, {UNIT: make_device()}) as place,
        context_at(str(place.end)) as context,
    ):
        for check, (ask, answer) in each(LACKING.values()):
            with check:
                assert ask(context) == answer
        assert context.read_comm_event_counter().status == 0
        assert context.read_comm_event_log().status == 0
        with pytest.raises(IllegalDataAddress) as caught:
            context.read_fifo_queue(7)
        assert (caught.value.unit, caught.value.function) == (UNIT, 24)
        assert context.read_holding_registers(100, 1) == [1100]


def test_raw_answers_of_another_unit_and_other_transactions_are_refused() -> None:
    wrong: dict[str, int] = {}
    with (
        TcpPeer(lambda request, write: write(mbap(request, b"\x07\x05", **wrong))) as peer,
        context_at(peer.url) as context,
    ):
        assert context.read_exception_status() == 5
        for key, value in {"unit": 9, "transaction": 5}.items():
            wrong.clear()
            wrong[key] = value
            with pytest.raises(InvalidResponse, match="answered by unit"):
                context.read_exception_status()
            assert context.socket == -1


@pytest.mark.parametrize("code", [0, 1, 6, 9, 11])
def test_codes_of_refusals_are_those_of_libmodbus(code: int) -> None:
    with (
        TcpPeer(lambda request, write: write(mbap(request, bytes([0x83, code])))) as peer,
        context_at(peer.url) as context,
    ):
        for _ in range(2):
            with pytest.raises(ExceptionResponse) as caught:
                context.read_holding_registers(5, 2)
            assert caught.value.code == code
            assert caught.value.asked == "ReadHoldingRegisters(address=5, count=2)"
            assert caught.value.endpoint == peer.url
        assert peer.connections == 1


def test_codes_that_libmodbus_drops_are_seen_by_execute() -> None:
    with (
        TcpPeer(lambda request, write: write(mbap(request, b"\x83\x63"))) as peer,
        context_at(peer.url) as context,
    ):
        with pytest.raises(InvalidResponse, match="Invalid exception code"):
            context.read_holding_registers(5, 2)
        with pytest.raises(ExceptionResponse) as caught:
            context.execute(pdu.ReadHoldingRegisters(5, 2))
        assert caught.value.code == 0x63


def test_a_server_of_any_unit_is_answered_over_ipv6() -> None:
    slave = TcpContext("::1", 0)
    try:
        slave.listen()
    except OSError:
        pytest.skip("this machine has no IPv6")
    with TcpContext("::1", slave.port, unit=255) as master:
        slave.accept()
        assert master._endpoint == f"tcp://[::1]:{slave.port}"
        assert master.socket >= 0
    slave.close()


def test_registers_are_unsigned_words_of_either_byte_order() -> None:
    values = [0, 1, 0x1234, 0xFFFF]
    body = struct.pack(">4H", *values)
    with (
        TcpPeer(lambda request, write: write(mbap(request, b"\x03\x08" + body))) as peer,
        context_at(peer.url) as context,
    ):
        assert context.read_holding_registers(0, 4) == values


ROOT = Path(__file__).parents[2]
DEBIAN = Path("/usr/share/doc/libmodbus-dev/examples/random-test-client.c")


@contextlib.contextmanager
def slave() -> Iterator[int]:
    """Run the slave until Ctrl-C, and yield its port."""
    command = [sys.executable, ROOT / "examples" / "slave.py", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline().split()[-1])
            assert process.stdout.readline().startswith("a master: 127.0.0.1:")
            assert "closed by the other side" in process.stdout.readline()
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30)
    assert process.returncode == 0


def test_the_random_client_of_libmodbus_reads_what_it_wrote() -> None:
    with slave() as port:
        run = subprocess.run(
            [sys.executable, ROOT / "examples" / "random_client.py", str(port)],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert (run.stdout, run.returncode) == ("600 reads, 0 of them wrong\n", 0), run.stderr


@pytest.mark.slow
def test_the_random_client_of_debian_reads_what_it_wrote(tmp_path: Path) -> None:
    if not DEBIAN.exists():
        pytest.skip(f"{DEBIAN} is not there: this system installs no documentation")
    with slave() as port:
        copy = tmp_path / DEBIAN.name
        text = DEBIAN.read_text(encoding="utf-8")
        assert ", 1502)" in text
        copy.write_text(text.replace(", 1502)", f", {port})"), encoding="utf-8")
        client = compile_c(copy, tmp_path / "client")
        process = subprocess.run([client], capture_output=True, text=True, timeout=60)
    assert "Test: SUCCESS" in process.stdout
