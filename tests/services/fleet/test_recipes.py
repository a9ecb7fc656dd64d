"""
The recipes of the documentation, with the programs that Debian has; what other programs get is
compared with what their configuration expects.
"""

from __future__ import annotations

import csv
import json
import re
import signal
import subprocess
import time
import tomllib
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.commands import parse_arguments
from tests.services.fleet.fleets import LONGEST, until
from tests.services.fleet.outputs.influxdb import Database
from tests.support.commands import Started, run_forked
from tests.support.programs import HeldPort, listens, missing, program

if TYPE_CHECKING:
    from tests.services.fleet.outputs.brokers import Broker

ROOT = Path(__file__).parents[3]

PAGE = ROOT / "docs" / "how-to" / "recipes.md"

ADDRESS = "tcp://127.0.0.1:1502"


@cache
def sections() -> dict[str, list[tuple[str, str]]]:
    """Return the blocks below each heading, each with its language."""
    parts = re.split(r"^## (.+)$", PAGE.read_text(), flags=re.MULTILINE)
    heads = ["", *parts[1::2]]
    texts = [parts[0], *parts[2::2]]
    return {
        head: re.findall(r"^```(\w+)[^\n]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        for head, text in zip(heads, texts, strict=True)
    }


def block(section: str, language: str, containing: str = "") -> str:
    """Return the only block of a language in a section that contains a text."""
    (text_,) = [
        text for entry, text in sections()[section] if entry == language and containing in text
    ]
    return text_


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[Path]:
    """The fleet file of the page, with a device that answers; `add` appends an output."""
    values = Mapping(input_registers={0: [2305]}, holding_registers={0: [200]})
    with Server(Device(values)).background("tcp://127.0.0.1:0") as running:
        (tmp_path / "meter.csv").write_text(block("", "csv"))
        fleet = block("", "toml").replace(ADDRESS, running.urls[0])
        # Often, so that no test waits, and for a machine that is busy.
        fleet = fleet.replace("interval = 5", f"interval = 0.1\ntimeout = {LONGEST}")
        (tmp_path / "fleet.toml").write_text(fleet)
        yield tmp_path / "fleet.toml"


def add(plant: Path, output: str) -> None:
    plant.write_text(f"{plant.read_text()}\n{output}")


@pytest.mark.skipif(bool(missing("influxd")), reason="Debian 13 has no InfluxDB")
def test_the_query_of_grafana_finds_a_line_for_each_device_in_influxdb(plant: Path, tmp_path):
    section = "Grafana with InfluxDB"
    database = Database(tmp_path)
    database.start()
    try:
        database.ask("DROP DATABASE plant")
        (create,) = re.findall(r"'q=(.*?)'", block(section, "sh"))
        database.ask(create)
        add(plant, block(section, "toml").replace("http://127.0.0.1:8086", database.url))
        assert run_forked("poll", plant, "--once").code == 0
        # What Grafana puts in place of its variables.
        query = block(section, "sql").replace("$timeFilter", "time > now() - 1h")
        (row,) = database.ask(query.replace("$__interval", "1h"))
        assert row["mean"] == 230.5
        (tag,) = database.ask('SHOW TAG VALUES FROM "modbus" WITH KEY = "site"')
        assert tag["value"] == "Halle"
    finally:
        database.close()
    assert "database: plant" in block(section, "yaml")


@pytest.mark.skipif(bool(missing("prometheus", "promtool")), reason="Prometheus is not installed")
def test_prometheus_asks_for_the_values(plant: Path, tmp_path: Path) -> None:
    section = "Grafana with Prometheus"
    pytest.importorskip("prometheus_client")
    with HeldPort() as metrics, HeldPort() as port:
        served = f"127.0.0.1:{metrics.number}"
        settings = block(section, "yaml", "scrape_configs").replace("127.0.0.1:9400", served)
        (tmp_path / "prometheus.yml").write_text(settings.replace("5s", "50ms"))
        check = [program("promtool"), "check", "config", "prometheus.yml"]
        subprocess.run(check, cwd=tmp_path, check=True, capture_output=True, timeout=60)
        command = [
            program("prometheus"),
            "--config.file=prometheus.yml",
            "--storage.tsdb.path=data",
            f"--web.listen-address=127.0.0.1:{port.number}",
        ]
        with (
            Started("poll", plant, "--metrics", served),
            subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL) as prometheus,
        ):
            try:
                listens(prometheus, port.number)
                query = urllib.parse.urlencode({"query": block(section, "text")})
                (sample,) = answer_of(f"http://127.0.0.1:{port.number}/api/v1/query?{query}")
            finally:
                prometheus.terminate()
    assert sample["value"][1] == "230.5"
    assert sample["metric"]["device"] == "north"


def answer_of(url: str) -> list[dict[str, Any]]:
    """Return the result of a query, as soon as there is one."""
    for _ in range(int(LONGEST * 50)):
        try:
            with urllib.request.urlopen(url, timeout=LONGEST) as answer:
                result: list[dict[str, Any]] = json.load(answer)["data"]["result"]
        except urllib.error.HTTPError as error:
            error.close()
            if error.code != 503:  # it has just started
                raise
            result = []
        if result:
            return result
        time.sleep(0.02)
    raise AssertionError("no result")


def test_telegraf_gets_lines_from_the_command_at_once(plant: Path) -> None:
    (inputs,) = tomllib.loads(block("Telegraf", "toml", "inputs.execd"))["inputs"]["execd"]
    assert (inputs["signal"], inputs["data_format"]) == ("none", "influx")
    name, *arguments = inputs["command"]
    assert name == "libmodbus-py"
    with Started(*(plant if item.endswith(".toml") else item for item in arguments)) as started:
        for _ in range(2):  # it comes while the command runs
            line = started.stdout.readline()
            assert re.fullmatch(
                r"modbus,device=north,site=Halle voltage=230\.5,setpoint=20\.0 \d{19}\n", line
            )
        started.send_signal(signal.SIGTERM)  # as Telegraf ends it
        assert started.wait() == 0


async def test_telegraf_reads_what_the_broker_gets(plant: Path, broker: Broker) -> None:
    (inputs,) = tomllib.loads(block("Telegraf", "toml", "mqtt_consumer"))["inputs"]["mqtt_consumer"]
    messages = await heard_from(plant, broker, *inputs["topics"])
    (parsing,) = inputs["topic_parsing"]
    assert [parsing["topic"]] == inputs["topics"]
    for topic, payload in messages.items():
        tags = dict(zip(parsing["tags"].split("/"), topic.split("/"), strict=True))
        assert tags["device"] == "north"
        assert tags["name"] in ("voltage", "setpoint")
        assert {*inputs["tag_keys"], *inputs["json_string_fields"]} <= payload.keys()
        # Go's layout means RFC 3339, with or without fractions of seconds.
        assert inputs["json_time_format"] == "2006-01-02T15:04:05Z07:00"
        when = payload[inputs["json_time_key"]]
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z", when)
        assert datetime.fromisoformat(when).tzinfo is not None
    assert messages["plant/north/voltage"]["value"] == 230.5


async def heard_from(plant: Path, broker: Broker, *topics: str) -> dict[str, Any]:
    """Poll with the output to MQTT of the page, and return the last message of each topic."""
    from tests.services.fleet.outputs.brokers import hearing  # MQTT's client is an extra

    add(plant, block("Node-RED", "toml").replace("mqtt://127.0.0.1", broker.url))
    count = 2 if topics == ("plant/+/+",) else len(topics)
    with Started("poll", plant):
        async with hearing(broker, *topics) as messages:
            await until(lambda: len({topic for topic, *_ in messages}) >= count)
            return {topic: payload for topic, payload, _ in messages}


async def test_node_red_uses_only_topics_that_exist(plant: Path, broker: Broker) -> None:
    nodes = {node["id"]: node for node in json.loads(block("Node-RED", "json"))}
    for node in nodes.values():
        assert {target for wires in node.get("wires", ()) for target in wires} <= nodes.keys()
    assert {nodes[entry]["broker"] for entry in ("in", "out")} == {"broker"}
    assert nodes["broker"]["type"] == "mqtt-broker"
    messages = await heard_from(plant, broker, nodes["in"]["topic"])
    (rule,) = nodes["good"]["rules"]
    good = [payload for payload in messages.values() if payload["quality"] == rule["v"]]
    assert {payload["value"] for payload in good} == {230.5, 20.0}
    assert nodes["good"]["property"] == "payload.quality"
    assert nodes["show"]["complete"] == "payload.value"


async def test_the_button_of_node_red_writes_a_value(plant: Path, broker: Broker) -> None:
    from tests.services.fleet.outputs.brokers import hearing, publish

    nodes = {node["id"]: node for node in json.loads(block("Node-RED", "json"))}
    topic = nodes["out"]["topic"]
    add(plant, block("Node-RED", "toml").replace("mqtt://127.0.0.1", broker.url))
    with Started("poll", plant):
        async with hearing(broker, "plant/north/setpoint", f"{topic}/result") as messages:
            # A reading is published after the output has subscribed to commands.
            await until(lambda: "plant/north/setpoint" in [message[0] for message in messages])
            await publish(broker, topic, nodes["button"]["payload"].encode())
            await until(lambda: f"{topic}/result" in [message[0] for message in messages])
            (result,) = [payload for item, payload, _ in messages if item == f"{topic}/result"]
    assert result["ok"] is True


async def test_home_assistant_finds_a_device_removed_in_a_reload(plant: Path, broker: Broker):
    from tests.services.fleet.outputs.home_assistant import home_assistant

    before = plant.read_text()
    add(plant, block("Home Assistant", "toml").replace("mqtt://127.0.0.1", broker.url))
    async with home_assistant(broker) as home:
        with Started("poll", plant) as started:
            await until(lambda: home.names and home.is_available("voltage", "north"))
            assert home.names == {"sensor: north: voltage", "number: north: setpoint"}
            await until(lambda: (home.state("voltage"), home.state("setpoint")) == (230.5, 20))
            _, setpoint = home.entity("setpoint")
            keys = ("min", "max", "step", "unit_of_measurement", "device_class")
            assert [setpoint[key] for key in keys] == [10, 30, 0.1, "°C", "temperature"]
            await home.set("setpoint", 21.5)
            await until(lambda: home.state("setpoint") == 21.5)
            south = before.replace('"north"', '"south"') + 'items = ["voltage"]\n'
            assert south != before
            plant.write_text(plant.read_text().replace(before, south))
            started.send_signal(signal.SIGHUP)
            await until(lambda: home.names == {"sensor: south: voltage"})


@pytest.mark.parametrize("hangs_up", [False, True])
def test_a_file_renamed_by_logrotate_is_begun_again(plant: Path, hangs_up: bool) -> None:
    section = "Rotate files of readings"
    path = plant.parent / "readings.csv"
    (place,) = re.findall(r'path = "(.*)"', block(section, "toml"))
    settings = block(section, "text")
    assert settings.startswith(f"{place} {{")
    # Renames, leaves no file behind, and compresses what was renamed the time before.
    assert {"nocreate", "delaycompress"} <= set(settings.split())
    assert not {"copytruncate", "create"} & set(settings.split())
    add(plant, block(section, "toml").replace(place, path.name) + "[output.json]\n")
    with Started("poll", plant) as started:
        printed = [started.stdout.readline() for _ in range(4)]
        old = path.rename(path.with_suffix(".csv.1"))
        if hangs_up:
            started.send_signal(signal.SIGHUP)
        deadline = time.monotonic() + LONGEST
        while not path.exists() and time.monotonic() < deadline:
            printed.append(started.stdout.readline())
        started.send_signal(signal.SIGTERM)
        printed += started.stdout.readlines()
        assert started.wait() == 0
    readings = []
    for entry in (old, path):
        with entry.open(newline="") as file:
            header, *rows = csv.reader(file, strict=True)
        assert header[:3] == ["time", "device", "name"]
        assert rows
        readings += [(row[0], row[2]) for row in rows]
    assert readings == [(line["time"], line["name"]) for line in map(json.loads, printed)]


def test_the_container_starts_an_existing_command() -> None:
    text = block("Containers", "yaml")
    (command,) = re.findall(r"command: (\[.*\])", text)
    name, *arguments = json.loads(command)
    assert name == "libmodbus-py"
    assert parse_arguments(arguments).file == "/fleet/fleet.toml"
    (file,) = re.findall(r"build: {context: ., dockerfile: (\S+)}", text)
    assert "influx" in (ROOT / file).read_text()
