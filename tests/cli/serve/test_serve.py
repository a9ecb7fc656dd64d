"""The commands serve and gateway: what they serve, and what they say when they start."""

import contextlib
import io
import json
import signal
from pathlib import Path

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.cli.serve.running import announce
from libmodbus_py.tools.testing.wires import SerialWire
from tests.cli.serving import serving
from tests.support.cases import each_case
from tests.support.commands import PAGE_TOKEN, Started, page_url, run
from tests.tools.page.tables import name_of
from tests.tools.page.watching import Visitor

SERVE = ("serve", "tcp://127.0.0.1:0")


def test_serve_has_all_tables_and_files_for_every_unit(url: str) -> None:
    for unit, *where in (
        ("1", "coils", "0", "2000"),
        ("247", "discrete", "65535"),
        ("0", "holding", "65411", "125"),
        ("255", "input", "65535", "1"),
        ("9", "file:1", "0"),
        ("9", "file:10", "9900", "100"),
    ):
        result = run("read", url, *where, "--unit", unit, "--json")
        assert result.code == 0, result.err
        assert set(json.loads(result.out)["values"]) == {0}


@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_serial_ports_are_served_and_read(kind: str) -> None:
    with (
        SerialWire() as wire,
        serving("serve", f"{kind}://{wire.server}", "-b", "115200") as (_, url),
    ):
        assert url == f"{kind}://{wire.server}?baudrate=115200"
        client = f"{kind}://{wire.client}?baudrate=115200"
        assert run("write", client, "holding", "5", "42").code == 0
        assert run("read", client, "holding", "5", "-p", "even") == (0, "    5  42\n", "")


def test_serve_reports_that_a_port_is_in_use(url: str) -> None:
    result = run("serve", url)
    assert result.code == 1
    assert result.err == f"libmodbus-py: cannot listen on {url}: Address already in use\n"


@each_case(
    ("urls", "count"),
    [
        (["tcp://0.0.0.0:1"], 1),
        (["tcp://[::]:1"], 1),
        (["rtu+tcp://0.0.0.0:1", "udp://plc.example:502", "tcp://127.0.0.1:1"], 2),
        (["tcp://127.0.0.1:1", "tcp://[::1]:1", "udp://localhost:1", "tcp://127.1.2.3:1"], 0),
        (["tls://0.0.0.0:1", "rtu:///dev/ttyS0", "unix:///run/modbus"], 0),
    ],
)
@each_case("is_guarded", [True, False])
def test_serve_says_in_one_line_that_anyone_may_write(urls, count, is_guarded) -> None:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        announce(urls, is_guarded=is_guarded)
    assert out.getvalue().splitlines() == [f"listening on {url}" for url in urls]
    text, count = err.getvalue(), 0 if is_guarded else count
    assert text.count("\n") == (count > 0)
    assert [url for url in urls if url in text] == urls[:count]
    assert ("anyone" in text) == ("--allow" in text) == (count > 0)


def test_serve_has_the_units_that_were_typed() -> None:
    with serving(*SERVE, "-u", "3,5-6") as (_, url), Client(url, timeout=5) as plc:
        plc.for_unit(3).write_register(0, 7)
        assert plc.for_unit(6).read_holding_registers(0, 1) == [0]
        assert run("read", url, "-u", "4", "hr", 0).code == 1


def test_a_map_of_the_package_is_served_by_its_name_to_some_units() -> None:
    with serving(*SERVE, "--map", "sdm120", "-u", "1,17") as (_, url):
        result = run("read", url, "--map", "sdm120", "-u", "17", "voltage")
        assert (result.code, result.err) == (0, "")
        assert "voltage" in result.out
        assert run("read", url, "--map", "sdm120", "-u", "3", "voltage").code == 1


def test_a_map_of_a_file_is_enforced_and_its_columns_are_named(tmp_path: Path) -> None:
    path = tmp_path / "heat.csv"
    path.write_text("Bezeichnung,table,address,type,access\npower,holding,1,uint32,read\n")
    options = ("--map", path, "--column", "name=Bezeichnung")
    with serving(*SERVE, *options) as (_, url):
        assert run("read", url, *options, "power").out == "power  0\n"
        assert "illegal data address" in run("write", url, "hr", 1, 5).err


def test_a_gateway_has_the_units_that_were_typed(device: str) -> None:
    to = device.removeprefix("tcp://")
    with serving("gateway", "127.0.0.1:0", "--to", to, "-u", "2") as (_, url):
        assert run("read", url, "-u", "2", "hr", 0).code == 0
        result = run("read", url, "-u", "1", "hr", 0)
        assert "gateway path unavailable (exception 10)" in result.err


def test_one_gateway_command_shares_a_device_over_several_transports(device: str) -> None:
    schemes = ("tcp", "udp", "rtu+tcp")
    places = [f"{scheme}://127.0.0.1:0" for scheme in schemes]
    with serving("gateway", *places, "--to", f"{device}?timeout=2") as (process, first):
        others = [process.stdout.readline().split()[-1] for _ in schemes[1:]]
        for url, scheme in zip([first, *others], schemes, strict=True):
            assert url.startswith(f"{scheme}://")
            with Client(url, unit=1) as context:
                context.write_register(0, len(url))
                assert context.read_holding_registers(0, 1) == [len(url)]


def test_a_page_shows_the_gateway() -> None:
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as behind:
        place = behind.urls[0]
        command = ("gateway", "tcp://127.0.0.1:0", "--to", place, "--page", "127.0.0.1:0")
        with Started(*command, environment=PAGE_TOKEN) as process:
            page, listening = sorted((process.stdout.readline() for _ in range(2)), reverse=True)
            with Visitor(page_url(page)).watching() as visitor:
                assert visitor.seen["head"]["kind"] == "gateway"
                assert visitor.seen["head"]["title"] == "tcp://127.0.0.1:0"
                with Client(listening.split()[-1], unit=5, timeout=10) as plc:
                    plc.read_holding_registers(0, 2)
                visitor.receive(lambda: visitor.seen["log"])
                visitor.look_at(find="127.0.0.1 function")
                visitor.receive(lambda: visitor.rows("rows"))
                row = visitor.seen["rows"]["0"]
                assert name_of(row) == ["127.0.0.1", "unit 5, 3 read holding registers"]
                assert (row["state"]["word"], row["requests"]) == ("client", 1)
            process.send_signal(signal.SIGTERM)
            process.wait()
