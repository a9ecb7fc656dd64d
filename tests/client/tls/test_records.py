"""The records of a TLS connection, and how it ends."""

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from libmodbus_py import ModbusConnectionError, State, TracedFrame
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.clients import Connect
from tests.support.peers import echo
from tests.support.reads import echoes, reads
from tests.support.tls_clients import LONG, Serving, Talking
from tests.support.tls_peers import HANDSHAKE, Peer, Script, Sealed

ALERT, ACCESS_DENIED = 21, b"\x02\x31"


@pytest.mark.parametrize("key", ["EC", "RSA"])
def test_ec_and_rsa_keys_serve_in_both_versions(talking: Talking, pki: Pki, version: str, key):
    options = {"key": certificates.rsa_key()} if key == "RSA" else {}
    own = {"security": pki.security(certificates.client(**options))}
    identity = certificates.server(**options)
    with talking(Peer.serve, identity, version, client=own) as (server, plc):
        assert [plc.read_holding_registers(number, 1) for number in range(3)] == echoes(3)
        assert plc.execute_many(reads(300)) == echoes(300)
    assert server.connections == 1


def test_a_chain_with_an_intermediate_authority_is_accepted(talking: Talking, pki: Pki) -> None:
    below = certificates.intermediate()
    own = {"security": pki.security(certificates.client(issuer=below))}
    with talking(identity=certificates.server(issuer=below), client=own) as (_, plc):
        assert plc.read_holding_registers(7, 1) == [7]


def one_byte_records(peer: Peer) -> None:
    peer.serve(lambda request: [bytes([entry]) for entry in echo(request)])


def one_byte_segments(peer: Peer) -> None:
    while request := peer.request():
        for entry in peer.sealed(echo(request)):
            peer.sock.sendall(bytes([entry]))


def two_records_apart(peer: Peer) -> None:
    while request := peer.request():
        answer = echo(request)
        peer.write(answer[:5])
        time.sleep(0.02)
        peer.write(answer[5:])


def many_in_one_record(peer: Peer) -> None:
    while request := peer.request():
        answers = echo(request)
        while peer.tls.pending():
            answers += echo(peer.request())
        peer.write(answers)


@pytest.mark.parametrize(
    "script", [one_byte_records, one_byte_segments, two_records_apart, many_in_one_record]
)
def test_frames_are_split_over_records_in_any_way(talking: Talking, version: str, script: Script):
    with talking(script, version=version) as (server, plc):
        assert [plc.read_holding_registers(number, 1) for number in range(3)] == echoes(3)
        assert plc.execute_many(reads(40)) == echoes(40)
    assert server.connections == 1


def test_tickets_changes_of_keys_and_empty_records_between_answers(talking: Talking, tmp_path):
    log = tmp_path / "keys"
    other: list[Callable[[Sealed], bytes]] = [
        lambda sealed: sealed.record(sealed.ticket(), HANDSHAKE),
        lambda sealed: sealed.change_of_keys(),
        lambda sealed: sealed.change_of_keys(is_answer_wanted=True),
        lambda sealed: sealed.record(b""),
    ]

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        turn = 0
        while request := peer.request():
            answer = echo(request)
            make = other[turn % 4]
            before = turn // 4 % 3 == 0
            data = make(sealed) if before else b""
            data += sealed.record(answer[:4])
            data += make(sealed) if turn // 4 % 3 == 1 else b""
            data += sealed.record(answer[4:])
            data += make(sealed) if turn // 4 % 3 == 2 else b""
            peer.sock.sendall(data)
            turn += 1

    with talking(script, version="1.3", keylog_filename=str(log)) as (server, plc):
        for number in range(24):
            assert plc.read_holding_registers(number, 1) == [number]
        assert plc.execute_many(reads(100)) == echoes(100)
    assert server.connections == 1


def test_requests_wait_while_a_ticket_comes_in_pieces(talking: Talking, tmp_path: Path) -> None:
    """OpenSSL encrypts nothing in the midst of a message of the handshake's kind."""
    log = tmp_path / "keys"
    halves, arrival = threading.Event(), threading.Event()

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        ticket = sealed.ticket()
        peer.sock.sendall(
            sealed.record(echo(peer.request())) + sealed.record(ticket[:20], HANDSHAKE)
        )
        halves.set()
        arrival.wait(LONG)
        time.sleep(0.1)
        peer.sock.sendall(sealed.record(ticket[20:], HANDSHAKE))
        while request := peer.request():
            peer.sock.sendall(sealed.record(echo(request)))

    with talking(script, version="1.3", keylog_filename=str(log)) as (server, plc):
        assert plc.read_holding_registers(1, 1) == [1]
        assert halves.wait(LONG)
        time.sleep(0.1)
        arrival.set()
        assert plc.read_holding_registers(2, 1) == [2]
        assert plc.execute_many(reads(40)) == echoes(40)
    assert server.connections == 1


def test_the_trace_shows_the_frames_inside_records(talking: Talking) -> None:
    frames: list[TracedFrame] = []
    states: list[State] = []
    callbacks = {"trace": frames.append, "on_state": lambda state, error: states.append(state)}
    with talking(client=callbacks) as (server, plc):
        plc.read_holding_registers(0x0102, 1)
        assert plc.url == server.url
        assert (plc.statistics.requests, plc.statistics.responses) == (1, 1)
        assert plc.statistics.connects == 1
    request, response = frames
    assert request.adu[2:].hex() == "0000000601" + "0301020001"
    assert response.adu[2:].hex() == "0000000501" + "03020102"
    assert states == [State.CONNECTING, State.CONNECTED, State.CLOSED]


def test_an_answer_and_a_close_notify_together_are_received(talking: Talking) -> None:
    """
    The answer counts, and who waits for another one hears at once that there is none: TLS has
    ended, though TCP has not.
    """
    event = threading.Event()

    def script(peer: Peer) -> None:
        if event.is_set():  # the other requests are repeated
            assert len([peer.request() for _ in range(3)]) == 3
            return
        requests = [peer.request() for _ in range(4)]
        event.set()
        peer.sock.sendall(peer.sealed(echo(requests[0])) + peer.end())
        peer.sock.recv(1)

    with talking(script, client={"timeout": 600, "max_in_flight": 8}) as (_, plc):
        outcomes = plc.execute_many(reads(4), return_exceptions=True)
        assert outcomes[0] == [0]
        assert [type(outcome) for outcome in outcomes[1:]] == [ModbusConnectionError] * 3
        assert "closed by the other side" in str(outcomes[1])


def test_an_answer_with_an_alert_is_read(connect: Connect, pki: Pki, serving: Serving, tmp_path):
    """More requests wait to be sent, and cannot be any more."""
    log = tmp_path / "keys"
    sockets: list[socket.socket] = []

    def script(peer: Peer) -> None:
        sealed = Sealed(log, count=peer.tls.context.num_tickets)
        request = peer.request()
        sockets.append(peer.sock.dup())
        server.script = Peer.serve
        peer.sock.sendall(sealed.record(echo(request)) + sealed.record(ACCESS_DENIED, ALERT))

    with serving(script, version="1.3", keylog_filename=str(log)) as server:
        with connect(server.url, security=pki.client(), timeout=600, max_in_flight=4) as plc:
            outcomes = plc.execute_many(reads(9), return_exceptions=True)
        sockets[0].close()
    errors = [outcome for outcome in outcomes if isinstance(outcome, ModbusConnectionError)]
    assert outcomes[0] == [0]
    assert errors
    assert {error.args[0].partition(": ")[0].partition(" ")[2] for error in errors} == {
        "refused our certificate (tlsv1 alert access denied)"
    }
    assert outcomes[-1] == [8]


def test_a_connection_that_ends_within_a_record_is_lost(talking: Talking) -> None:
    def script(peer: Peer) -> None:
        peer.sock.sendall(peer.sealed(echo(peer.request()))[:20])

    with talking(script) as (server, plc):
        with pytest.raises(ModbusConnectionError, match="closed by the other side"):
            plc.read_holding_registers(0, 1)
        server.script = Peer.serve
        assert plc.read_holding_registers(4, 1) == [4]
