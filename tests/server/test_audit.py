"""The audit trail: each write and each refusal, by whom, with the values before and after."""

import errno
import json
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    Access,
    Client,
    Device,
    ExceptionResponse,
    Gateway,
    IllegalDataAddress,
    IllegalFunction,
    Limits,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    Route,
    Rules,
    Server,
    ServerDeviceBusy,
    ServerDeviceFailure,
    pdu,
)
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.serve import Allow, Audit, AuditEvent, AuditFile, ClientRequest
from libmodbus_py.server import audit
from tests.support import certificates
from tests.support.cases import each_case
from tests.support.certificates import Pki
from tests.support.events import Events, certificate_fields, identity_fields
from tests.support.names import NEEDS_IPV6
from tests.support.peers import until

TRANSPORTS = ("tcp", "rtu+tcp", "ascii+tcp", "udp")


def device(**options: Any) -> Device:
    mapping = Mapping(coils=10, holding_registers={0: [1, 2, 3, 4]})
    return Device(mapping, files={4: [7, 8, 9]}, **options)


@contextmanager
def asking(server: Server | Gateway, transport: str = "tcp") -> Iterator[Any]:
    with (
        server.background(f"{transport}://127.0.0.1:0") as running,
        Client(running.urls[0], unit=5, timeout=20) as client,
    ):
        yield client


def said(event: AuditEvent) -> dict[str, Any]:
    """Return an event as it is written, without time and peer."""
    entry = json.loads(event.json())
    assert entry.pop("time").endswith("Z")
    assert entry.pop("peer").startswith("127.0.0.1:")
    return dict(entry)


@NEEDS_IPV6
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_an_ipv6_client_has_one_name_in_all_records(transport: str, events: Events) -> None:
    """In all events, as in URLs: with brackets around the address."""
    names: list[str | None] = []
    server = Server(device(), audit=events.append, trace=lambda each: names.append(each.peer))
    other_server = Server(device(), limits=Limits(allow=["192.0.2.0/24"]), audit=events.append)
    url = f"{transport}://[::1]:0"
    with server.background(url) as one, other_server.background(url) as other:
        with Client(one.urls[0], unit=5, timeout=20) as client:
            client.write_register(0, 1)
        with Client(other.urls[0], unit=5, timeout=0.1) as client, pytest.raises(ModbusError):
            client.write_register(0, 1)
    assert {event.event for event in events} == {"write", "disallowed"}
    for peer in (*names, *(event.peer for event in events)):
        assert peer is not None
        assert re.fullmatch(r"\[::1\]:\d+", peer)


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_each_write_is_recorded_with_old_and_new_values(transport: str, events: Events) -> None:
    with asking(Server(device(), audit=events.append), transport) as plc:
        plc.write_registers(1, [20, 30])
        plc.write_coil(3, True)
        plc.mask_write_register(0, 0xFF00, 0x10)
        plc.read_write_registers(0, 1, 2, [31])
        plc.write_file_records([(4, 1, (88,))])
        assert plc.read_holding_registers(0, 4) == [0x10, 20, 31, 4]
    registers = "holding_registers"
    assert [said(event)["changes"] for event in events] == [
        [{"table": registers, "address": 1, "old": [2, 3], "new": [20, 30]}],
        [{"table": "coils", "address": 3, "old": [False], "new": [True]}],
        [{"table": registers, "address": 0, "old": [1], "new": [0x10]}],
        [{"table": registers, "address": 2, "old": [30], "new": [31]}],
        [{"table": "file", "file": 4, "address": 1, "old": [8], "new": [88]}],
    ]
    first = said(events[0])
    assert (first["event"], first["result"], first["unit"], first["function"]) == (
        "write", "ok", 5, 16
    )  # fmt: skip
    assert first["data"] == "10000100020400140" + "01e"


def test_a_write_that_fails_and_one_that_is_not_allowed_are_recorded(events: Events) -> None:
    rules = Rules({None: Allow(read=["coils"], write=["holding_registers"])})
    with asking(Server(device(authorize=rules), audit=events.append)) as plc:
        plc.read_coils(0, 1)
        with pytest.raises(IllegalDataAddress):
            plc.write_register(100, 1)
        with pytest.raises(IllegalFunction):
            plc.write_coil(0, True)
        with pytest.raises(IllegalFunction):
            plc.read_holding_registers(0, 1)
    assert [(event.event, event.function, event.result) for event in events] == [
        ("write", 6, "illegal data address (exception 2)"),
        ("write", 5, "illegal function (exception 1)"),
        ("refused", 3, "illegal function (exception 1)"),
    ]
    assert said(events[0])["changes"][0]["old"] is None


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_only_what_authorize_does_not_allow_is_recorded_as_refused(transport, events: Events):
    """Others get exception 1, too; and a status of 1 looks like one (section 6.7)."""

    def authorize(asked: ClientRequest) -> bool:
        if asked.function == 4:
            raise ServerDeviceBusy
        if asked.function == 2:
            raise IllegalFunction
        return asked.function != 1

    def refuse(access: Access) -> None:
        raise IllegalFunction

    device_ = device(authorize=authorize, before_read=refuse, exception_status=1)
    server = Server(device_, audit=events.append)
    with (
        server.background(f"{transport}://127.0.0.1:0") as running,
        Client(running.urls[0], unit=5, timeout=20) as plc,
    ):
        assert plc.read_exception_status() == 1
        with pytest.raises(IllegalFunction):  # the hook refuses it
            plc.read_holding_registers(0, 1)
        with pytest.raises(IllegalFunction):  # the device lacks this function
            plc.execute(pdu.RawRequest(0x65, b"\0"))
        with pytest.raises(IllegalDataAddress):
            plc.read_fifo_queue(9)
        assert events == []
        for read in (plc.read_coils, plc.read_discrete_inputs, plc.read_input_registers):
            with pytest.raises(ExceptionResponse):
                read(0, 1)
    assert [(event.event, event.function, event.result) for event in events] == [
        ("refused", 1, "illegal function (exception 1)"),
        ("refused", 2, "illegal function (exception 1)"),
        ("refused", 4, "server device busy (exception 6)"),
    ]
    assert (server.statistics.unauthorized, server.statistics.refused) == (1, 6)


def test_what_changes_a_device_without_an_address_is_recorded(events: Events) -> None:
    with asking(Server(device(), audit=events.append)) as plc:
        plc.execute(pdu.Diagnostics(pdu.SubFunction.RETURN_QUERY_DATA, b"ab"))
        plc.execute(pdu.Diagnostics(pdu.SubFunction.CLEAR_COUNTERS, bytes(2)))
        with pytest.raises(IllegalFunction):
            plc.execute(pdu.RawRequest(0x2B, b"\x0d\x01\x02"))
    assert [event.data for event in events] == ["08000a0000", "2b0d0102"]


def test_a_broadcast_is_recorded_for_each_device(events: Events) -> None:
    with asking(Server({1: device(), 2: device()}, audit=events.append), "rtu+tcp") as line:
        line.for_unit(0).write_register(0, 9)
        assert line.for_unit(1).read_holding_registers(0, 1) == [9]
    assert [(event.unit, event.result) for event in events] == [(0, "ok"), (0, "ok")]


def test_a_gateway_records_what_its_devices_answered(events: Events) -> None:
    with Server(device()).background("tcp://127.0.0.1:0") as behind:
        gateway = Gateway(
            [Route(behind.urls[0], writable=["holding_registers"])], audit=events.append
        )
        with asking(gateway) as plc:
            plc.write_register(0, 9)
            plc.mask_write_register(0, 0, 1)
            with pytest.raises(IllegalDataAddress):
                plc.write_register(100, 1)
            with pytest.raises(IllegalFunction):
                plc.write_coil(0, True)
            plc.read_holding_registers(0, 1)
    results = [(event.function, event.result, said(event)["changes"][0]["new"]) for event in events]
    assert results == [
        (6, "ok", [9]),
        (22, "ok", []),
        (6, "illegal data address (exception 2)", [1]),
        (5, "illegal function (exception 1)", [True]),
    ]


def test_starts_and_ends_of_servers_and_clients_are_recorded(
    tmp_path: Path, pki: Pki, events: Events
) -> None:
    operator = certificates.client("Operator")
    crl = tmp_path / "crl.pem"
    crl.write_bytes(certificates.revocation_list())
    server = Server(
        device(),
        limits=Limits(certificate_interval=0.01),
        security=pki.server(crl=crl),
        audit=events.append,
    )
    with server.background("tls://127.0.0.1:0") as running:
        (url,) = running.urls
        with Client(f"tls://127.0.0.1:{parse(url).port}", security=pki.client()) as plc:
            plc.write_register(0, 9)
            crl.write_bytes(certificates.revocation_list(operator))
            renewed = certificates.server(days=29)
            server.security = pki.security(renewed, crl=crl)
            until(lambda: len(events) == 3 and len(events.own) == 2)

            def is_refused() -> bool:
                """Try again: at first the client may only notice that its connection is closed."""
                with pytest.raises(ModbusConnectionError):
                    plc.read_holding_registers(0, 1)
                return len(events) >= 4

            until(is_refused)
    assert [(event.event, event.result, event.role) for event in events[:4]] == [
        ("logon", "ok", "Operator"),
        ("write", "ok", "Operator"),
        ("ended", "certificate revoked", "Operator"),
        ("handshake", "certificate revoked", None),
    ]
    assert {identity_fields(event) for event in events} == {certificate_fields(operator)}
    assert [(future.event, future.result) for future in events.own] == [
        ("start", url),
        ("renewed", url),
        ("stop", url),
    ]
    assert identity_fields(events.own[1]) == certificate_fields(renewed)


@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_a_peer_from_another_network_is_recorded_once_a_minute(transport, events: Events) -> None:
    server = Server(device(), limits=Limits(allow=["192.0.2.0/24"]), audit=events.append)
    with server.background(f"{transport}://127.0.0.1:0") as running:
        for _ in range(3):
            with (
                Client(running.urls[0], timeout=0.05, retries=0) as plc,
                pytest.raises(Exception, match=r"."),
            ):
                plc.read_coils(0, 1)
        until(lambda: server.statistics.disallowed >= 3)
    assert [(event.event, event.result) for event in events] == [
        ("disallowed", "not in an allowed network")
    ]


class Failing:
    """An audit that records events unless it is told to fail."""

    def __init__(self) -> None:
        self.taken: list[AuditEvent] = []
        self.fails = False

    def __call__(self, event: AuditEvent) -> None:
        if self.fails:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if event.peer:  # events without a peer are those of the server itself
            self.taken.append(event)


@pytest.mark.parametrize("kind", ["server", "gateway"])
def test_writes_are_refused_while_a_required_trail_fails(kind, caplog) -> None:
    """The write whose record failed waits, and comes first when the trail works again."""
    trail = Failing()
    audit = Audit(trail, required=True)
    with Server(device()).background("tcp://127.0.0.1:0") as behind:
        server: Server | Gateway = Server(device(), audit=audit)
        if kind == "gateway":
            server = Gateway([Route(behind.urls[0])], audit=audit)
        with asking(server) as plc:
            trail.fails = True
            plc.write_register(0, 8)
            for _ in range(2):
                with pytest.raises(ServerDeviceFailure):
                    plc.write_register(0, 9)
            assert plc.read_holding_registers(0, 1) == [8]
            trail.fails = False
            plc.write_register(0, 10)
    values = [(future.changes[0].access.values, future.result) for future in trail.taken]
    failure = "server device failure (exception 4)"
    assert values == [((8,), "ok"), ((9,), failure), ((9,), failure), ((10,), "ok")]
    assert [message for message in caplog.messages if "audit" in message] == [
        "audit: OSError: [Errno 28] No space left on device",
        "audit: events are recorded again; 0 were lost",
    ]


def test_writes_continue_while_an_optional_trail_fails_and_losses_are_logged(caplog) -> None:
    trail = Failing()
    with asking(Server(device(), audit=trail)) as plc:
        trail.fails = True
        for value in range(1003):
            plc.write_register(0, value)
        trail.fails = False
        plc.write_register(0, 5)
    assert len(trail.taken) == 1000
    assert caplog.messages[-1] == "audit: events are recorded again; 4 were lost"


def move(path: Path) -> None:
    path.rename(path.with_name("audit.json.1"))


def replace_by_another(path: Path) -> None:
    move(path)
    path.write_text("")


def refuse_to_open(path: Path) -> None:
    path.unlink()
    path.mkdir()


def fill_the_disk(path: Path) -> None:
    """Ask for more room than a disk can have."""
    audit.ROOM_BYTES = 1 << 62


def do_nothing(path: Path) -> None:
    """In this test a pipe loses its reader instead."""


TROUBLES = [
    (Path.unlink, "No such file or directory"),
    (move, "No such file or directory"),
    (replace_by_another, "another file has this path"),
    (fill_the_disk, "No space left on device"),
    (refuse_to_open, "another file has this path"),
    (do_nothing, "this pipe has no reader"),
]


@pytest.mark.parametrize(("trouble", "reason"), TROUBLES)
def test_a_write_that_a_required_file_cannot_record_is_not_executed(
    trouble, reason, tmp_path, caplog, monkeypatch
) -> None:
    monkeypatch.setattr(audit, "ROOM_BYTES", audit.ROOM_BYTES)
    path, reader = tmp_path / "audit.json", -1
    if trouble is do_nothing:
        os.mkfifo(path)
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    file = AuditFile(path)
    device_ = device()
    with asking(Server(device_, audit=Audit(file, required=True))) as plc:
        plc.write_register(0, 8)
        if reader >= 0:
            os.close(reader)
        trouble(path)
        for value in (9, 10):
            with pytest.raises(ServerDeviceFailure):
                plc.write_register(0, value)
        assert device_.mapping.holding_registers[0] == 8
        assert [reason in message for message in caplog.messages if "audit" in message] == [True]
        monkeypatch.undo()
        if trouble is refuse_to_open:
            with pytest.raises(IsADirectoryError):
                file.reopen()
            with pytest.raises(ServerDeviceFailure):
                plc.write_register(0, 11)
            path.rmdir()
        elif trouble is do_nothing:
            path.unlink()
        file.reopen()
        plc.write_register(0, 12)
    file.close()
    values = [line["changes"][0]["new"][0] for line in lines(path) if line["event"] == "write"]
    assert [value for value in values if value not in (8, 11)] == [9, 10, 12]


def test_an_audit_that_is_no_function_is_refused() -> None:
    for wrong in (5, "audit.json"):
        with pytest.raises(TypeError, match=r"audit must be a function, not (int|str)"):
            Server(device(), audit=wrong)  # type: ignore[arg-type]


def event(result: str = "ok") -> AuditEvent:
    return AuditEvent(datetime(2026, 1, 1, tzinfo=UTC), "write", "192.0.2.1:1", result)


def lines(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_renamed_file_is_reopened_under_its_path(tmp_path: Path) -> None:
    path = tmp_path / "audit.json"
    file = AuditFile(path)
    file(event("one"))
    path.rename(tmp_path / "audit.json.1")
    with pytest.raises(FileNotFoundError):
        file(event("two"))
    file.reopen()
    file(event("three"))
    path.write_text("{}\n")
    with pytest.raises(ValueError, match="is not an audit trail"):
        file.reopen()
    with pytest.raises(ValueError, match="is not an audit trail"):
        file.check()
    assert path.read_text() == "{}\n"
    file.close()
    assert [line["result"] for line in lines(tmp_path / "audit.json.1")] == ["one"]


def test_a_full_disk_is_an_error(tmp_path: Path) -> None:
    file = AuditFile("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        file(event())
    file.close()
    with pytest.raises(FileNotFoundError):
        AuditFile(tmp_path / "nowhere" / "audit.json")


def test_text_from_a_peer_takes_one_line_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "audit.json"
    file = AuditFile(path)
    file(event("a\nb\x1b[2J\u2028\ud800"))
    file.close()
    assert path.read_bytes().count(b"\n") == 1
    assert path.read_bytes().isascii()
    assert lines(path)[0]["result"] == "a\nb\x1b[2J\u2028\ud800"


# The fourth is what a fleet writes, the others begin files of JSON of other programs.
OTHER_FILES = [
    "[[device]]\n",
    "-----BEGIN PRIVATE KEY-----\n",
    "\0\0",
    '{"time": "2026-11-29T12:00:00Z", "device": "meter", "point": "power", "value": 1.5}\n',
    '{"name": "libmodbus"}\n',
    "{}\n",
    "[1, 2]\n",
    "{\n",
]


@each_case("text", OTHER_FILES)
def test_a_file_that_is_no_audit_trail_is_not_appended_to(tmp_path: Path, text: str) -> None:
    path = tmp_path / "file"
    path.write_text(text)
    with pytest.raises(ValueError, match="is not an audit trail"):
        AuditFile(path)
    assert path.read_text() == text


LINE = '{"time": "2026-11-29T12:00:00Z", "event": "write", "peer": "here", "result": "ok"}\n'


@each_case("text", ["", "\n", LINE, f"\n{LINE}", LINE[:60]])
def test_an_audit_trail_is_continued(tmp_path: Path, text: str) -> None:
    path = tmp_path / "audit.jsonl"
    path.write_text(text)
    for result in ("one", "two"):
        file = AuditFile(path)
        file(event(result))
        file.close()
        file.close()
    assert path.read_text() == f"{text}{event('one').json()}\n{event('two').json()}\n"


def test_a_file_is_readable_by_its_owner_only(tmp_path: Path) -> None:
    AuditFile(tmp_path / "audit.json").close()
    assert stat.S_IMODE((tmp_path / "audit.json").stat().st_mode) == 0o600


def test_a_named_pipe_without_a_reader_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises(OSError, match="No such device"):
        AuditFile(path)


def test_a_named_pipe_does_not_delay_clients(tmp_path: Path) -> None:
    """Its reader is slow, and then gone, also when the file is opened again."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    file = AuditFile(path)
    file(event())
    assert os.read(reader, 1000) == event().json().encode() + b"\n"
    with pytest.raises(BlockingIOError):  # noqa: PT012 - it fills the pipe
        while True:
            file(event())
    os.close(reader)
    with pytest.raises(BrokenPipeError):
        file(event())
    with pytest.raises(OSError, match="No such device"):
        file.reopen()
    file.close()
