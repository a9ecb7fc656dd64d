"""Options of serve: the audit file, the token of the page, certificates that are renewed."""

import json
import re
import signal
import ssl
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, ModbusConnectionError, ServerDeviceFailure
from tests.cli.serving import FLEET_OF_ONE, INFO, reload_line, serving
from tests.support import certificates
from tests.support.cases import each_case
from tests.support.certificates import Pki
from tests.support.commands import PAGE_TOKEN, Started, on_terminal, page_url, run
from tests.support.peers import until

TCP = "tcp://127.0.0.1:0"


def new_values(path: Path) -> list[Any]:
    lines = path.read_text().splitlines() if path.exists() else []
    events = [json.loads(line) for line in lines]
    return [event["changes"][0]["new"] for event in events if event["event"] == "write"]


def test_a_renamed_audit_file_is_left_on_hangup(command: list[str], tmp_path: Path) -> None:
    path, before = tmp_path / "audit.json", tmp_path / "audit.json.1"
    with serving(*command, TCP, "--audit", path) as (process, url), Client(url) as plc:
        plc.write_register(0, 1)
        until(lambda: new_values(path) == [[1]])
        path.rename(before)
        process.send_signal(signal.SIGHUP)
        until(path.exists)
        plc.write_register(0, 2)
        until(lambda: new_values(path) == [[2]])
    assert new_values(before) == [[1]]


def test_writes_are_refused_while_the_disk_is_full(command: list[str]) -> None:
    """Nothing can be written to /dev/full, as the start of the server shows."""
    with serving(*command, TCP, "--audit", "/dev/full", "--audit-required") as (process, url):
        with Client(url) as plc:
            with pytest.raises(ServerDeviceFailure):
                plc.write_register(0, 2)
            assert plc.read_holding_registers(0, 1) == [0]
        assert process.stderr.readline() == "audit: OSError: [Errno 28] No space left on device\n"


@pytest.mark.parametrize("command", ["serve", "gateway"])
def test_changes_of_a_file_that_is_read_again_are_recorded(command, tmp_path) -> None:
    file, trail = tmp_path / "file.toml", tmp_path / "audit.json"
    options = [TCP, "--device", file]
    cells = "[[unit.holding_registers]]\naddress = 0\n"
    texts = [f"[[unit]]\nid = {number}\n{cells}" for number in (1, 2)]
    if command == "gateway":
        options = ["--config", file]
        head = f'listen = ["{TCP}"]\n'
        texts = [f'{head}[[route]]\nurl = "tcp://127.0.0.1:{port}"\n' for port in (1502, 1503)]
    file.write_text(texts[0])
    with serving(command, *options, "--audit", trail) as (process, _):
        file.write_text(texts[1])
        process.send_signal(signal.SIGHUP)
        until(lambda: "reload" in trail.read_text())
    events = [json.loads(line) for line in trail.read_text().splitlines()]
    assert sorted(event["event"] for event in events) == ["audit", "reload", "start", "stop"]
    (result,) = (event["result"] for event in events if event["event"] == "reload")
    assert result.startswith(f"{file}: read again, 1 ")
    assert "1 new" in result or "1 changed" in result


(TOKEN,) = PAGE_TOKEN.values()


SERVE = ("serve", "tcp://127.0.0.1:0", "--page", "127.0.0.1:0")


@pytest.mark.parametrize("where", ["file", "environment"])
def test_a_token_in_a_file_opens_the_page_and_is_not_printed(where, tmp_path) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    file.chmod(0o600)
    options = ("--page-token", file) if where == "file" else ()
    environment = PAGE_TOKEN if where == "environment" else {}
    with Started(*SERVE, *options, "--log", "debug", environment=environment) as process:
        process.stdout.readline()
        url = page_url(process.stdout.readline())
        with urllib.request.urlopen(url) as answer:
            assert answer.status == 200
        with pytest.raises(urllib.error.HTTPError, match="403") as caught:
            urllib.request.urlopen(url[:-1])
        caught.value.close()
        process.terminate()
        assert TOKEN not in process.stdout.read() + process.stderr.read()


def test_a_new_token_is_printed_on_a_terminal() -> None:
    shows_url = re.compile(r"page on (http://\S+\?token=\S{32})\s").search
    with on_terminal(*SERVE) as terminal:
        match = shows_url(terminal.until(lambda text: shows_url(text) is not None))
        assert match
        with urllib.request.urlopen(match[1]) as answer:
            assert answer.status == 200


@each_case(
    ("content", "mode", "message"),
    [
        ("", 0o640, "token must have 22 or more letters, digits, - or _"),
        ("short", 0o640, "token must have 22 or more"),
        ("x" * 1001, 0o640, "token must have 22 or more"),
        (f"{TOKEN}&x=1", 0o640, "token must have 22 or more"),
        (f"{TOKEN}\nanother", 0o640, "token must have 22 or more"),
        ("\udcff" * 22, 0o640, "token must have 22 or more"),
        (TOKEN, 0o604, "file: all users of this machine can read this secret"),
        (None, 0, "No such file or directory"),
    ],
)
def test_a_wrong_token_is_an_error_that_does_not_show_it(tmp_path, content, mode, message) -> None:
    file = tmp_path / "file"
    file.unlink(missing_ok=True)
    if content is not None:
        file.write_bytes(content.encode(errors="surrogateescape"))
        file.chmod(mode)
    result = run(*SERVE, "--page-token", file)
    assert result.code == 2
    assert message in result.err
    assert result.err.count("\n") == 1
    assert TOKEN not in result.err


def test_files_of_certificates_are_read_again_on_hangup(command: list[str], pki: Pki, tmp_path):
    files = pki.files(certificates.server())
    crl = tmp_path / "crl.pem"
    crl.write_bytes(certificates.revocation_list())
    own = ["--cert", files.cert, "--key", files.key, "--ca", pki.ca, "--crl", crl]
    with serving(*command, "tls://127.0.0.1:0", *own, *INFO) as (process, url):
        port = int(url.rpartition(":")[2])
        with Client(f"tls://127.0.0.1:{port}", security=pki.client()) as plc:
            plc.read_holding_registers(0, 1)

        renewed = certificates.server(days=30)
        files.cert.write_bytes(renewed.pem)
        process.send_signal(signal.SIGHUP)
        assert reload_line(process) == (
            f"the former content is used: key {str(files.key)!r}: not the key of the certificate"
        )
        files.key.write_bytes(renewed.key_pem())
        crl.write_bytes(certificates.revocation_list(certificates.client("Operator")))
        process.send_signal(signal.SIGHUP)
        assert reload_line(process) == "certificates and passwords: read again"
        until(lambda: page_on(port) == renewed.der)
        with pytest.raises(ModbusConnectionError, match="refused our certificate"):
            Client(f"tls://127.0.0.1:{port}", security=pki.client()).read_holding_registers(0, 1)
        with Client(f"tls://127.0.0.1:{port}", security=pki.client("Viewer")) as plc:
            plc.read_holding_registers(0, 1)


FILES = {
    "serve": (["tls://127.0.0.1:0", "--device"], "[[unit]]\nid = 1\n", "1 unit"),
    "gateway": (
        ["tls://127.0.0.1:0", "--config"],
        '[[route]]\nurl = "tcp://127.0.0.1:1"\n',
        "1 route",
    ),
    "poll": ([], FLEET_OF_ONE, "1 device"),
}


@pytest.mark.parametrize("name", FILES)
def test_one_line_reports_the_result_of_all_files(name: str, pki: Pki, tmp_path: Path) -> None:
    files, file, trail = pki.files(certificates.server()), tmp_path / "file", tmp_path / "audit"
    arguments, text, what = FILES[name]
    own = {"cert": files.cert, "key": files.key, "ca": pki.ca}
    query = "&".join(f"{key}={value}" for key, value in own.items())
    file.write_text(text.format(url=f"tls://127.0.0.1:1?{query}"))
    options = [] if name == "poll" else [f"--{key}={value}" for key, value in own.items()]
    audit = [] if name == "poll" else ["--audit", str(trail)]
    with Started(name, *arguments, file, *options, *audit, *INFO) as process:
        process.stdout.readline()  # the first line: the URL, or the first poll
        files.key.write_bytes(certificates.server(days=30).key_pem())
        lines = []
        for _ in range(2):
            process.send_signal(signal.SIGHUP)
            lines.append(reload_line(process))
        process.terminate()
        lines += process.stderr
        assert process.wait() == 0
    opened = f"{trail}: opened again; " if audit else ""
    bad_key = f"the former content is used: key {str(files.key)!r}: not the key of the certificate"
    messages = {f"{file}: read again, {what}: no change", bad_key} | {opened[:-2]} - {""}
    assert [set(line.split("; ")) for line in lines[:2]] == [messages] * 2
    assert not [line for line in lines[2:] if "read again" in line or "former" in line]


def page_on(port: int) -> bytes:
    return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate(("127.0.0.1", port)))
