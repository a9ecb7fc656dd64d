"""
SIGHUP: commands that serve show a renewed certificate, and follow a revocation list.
"""

import signal
import ssl
from pathlib import Path

import pytest

from libmodbus_py import Client, ModbusConnectionError
from tests.cli.serving import FLEET_OF_ONE, INFO, reload_line, serving
from tests.support import certificates
from tests.support.certificates import Papers
from tests.support.commands import Started
from tests.support.peers import until


def test_files_of_certificates_are_read_again_on_hangup(
    command: list[str], papers: Papers, tmp_path: Path
) -> None:
    files = papers.files(certificates.server())
    crl = tmp_path / "crl.pem"
    crl.write_bytes(certificates.revocation_list())
    own = ["--cert", files.cert, "--key", files.key, "--ca", papers.ca, "--crl", crl]
    with serving(*command, "tls://127.0.0.1:0", *own, *INFO) as (process, url):
        port = int(url.rpartition(":")[2])
        with Client(f"tls://127.0.0.1:{port}", security=papers.client()) as plc:
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
        until(lambda: shown(port) == renewed.der)
        with pytest.raises(ModbusConnectionError, match="refused our certificate"):
            Client(f"tls://127.0.0.1:{port}", security=papers.client()).read_holding_registers(0, 1)
        with Client(f"tls://127.0.0.1:{port}", security=papers.client("Viewer")) as plc:
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
def test_one_line_says_what_became_of_all_files(name: str, papers: Papers, tmp_path: Path) -> None:
    files, file, trail = papers.files(certificates.server()), tmp_path / "file", tmp_path / "audit"
    arguments, text, what = FILES[name]
    own = {"cert": files.cert, "key": files.key, "ca": papers.ca}
    query = "&".join(f"{key}={value}" for key, value in own.items())
    file.write_text(text.format(url=f"tls://127.0.0.1:1?{query}"))
    options = [] if name == "poll" else [f"--{key}={value}" for key, value in own.items()]
    audit = [] if name == "poll" else ["--audit", str(trail)]
    with Started(name, *arguments, file, *options, *audit, *INFO) as process:
        process.stdout.readline()  # where it listens, or the first poll
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
    expected = {f"{file}: read again, {what}: no change", bad_key} | {opened[:-2]} - {""}
    assert [set(line.split("; ")) for line in lines[:2]] == [expected] * 2
    assert not [line for line in lines[2:] if "read again" in line or "former" in line]


def shown(port: int) -> bytes:
    return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate(("127.0.0.1", port)))
