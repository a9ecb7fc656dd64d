"""Fleet files: what they say, and what is wrong with them: file, line, key, what is allowed."""

import importlib
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet.config import (
    ENGINE,
    by_connection,
    devices_from_json,
    devices_to_json,
)
from libmodbus_py.services.fleet.files import FILE, SECRET, TABLE, FleetFileError, load
from libmodbus_py.services.fleet.outputs.kinds import KINDS, output_keys
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.services.fleet.fleets import METER, meter

EXAMPLE = Path(__file__).parents[3] / "examples" / "fleet.toml"

MAP = """name,table,address,type,scale,unit,access
voltage,holding_registers,0,uint16,0.1,V,read
power,holding_registers,2,float32,,W,read
reset,coils,5,,,,write
"""

FLEET = """
devices = "more.csv"

[defaults]
map = "meter.csv"
interval = 2.5
labels = {site = "here"}
dead_bands = {voltage = 0.5, power = 10}

[[device]]
name = "pump"
url = "tcp://192.0.2.7?timeout=2"
unit = 3
labels = {line = "A"}

[[device]]
name = "valve"
url = "rtu:///dev/ttyUSB0?baudrate=19200"
items = ["voltage"]
on_change = true
zone = "east"
timeout = 0.5
spacing = 0.1

[[device]]
name = "own"
url = "udp://[::1]:1502"
dead_bands = {level = 2}

[[device.point]]
name = "level"
table = "input_registers"
address = 7
scale = 0.01

[output.json]
path = "readings.jsonl"

[output.mqtt]
url = "mqtts://192.0.2.1"
user = "u"
password = "${TEST_MQTT_PASSWORD}"
commands = true
"""

CSV = """# a list
name;url;unit;map;items;interval;on_change;labels.site;zone
north 1;tcp://192.0.2.8;4;;voltage;7,5;;;
"""

CSV_RIGHT = CSV.replace("7,5", "7.5").replace("voltage;", "voltage;", 1)


def written(folder: Path, fleet: str = FLEET, csv: str = CSV_RIGHT, points: str = MAP) -> Path:
    (folder / "meter.csv").write_text(points)
    (folder / "more.csv").write_text(csv)
    (folder / "fleet.toml").write_text(fleet)
    return folder / "fleet.toml"


def test_default_dead_bands_of_points_that_a_device_does_not_read_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TEST_MQTT_PASSWORD", "secret")
    fleet = FLEET.partition('[[device]]\nname = "own"')[0]
    pump, valve, north = load(written(tmp_path, fleet)).devices
    assert pump.dead_bands == {"voltage": 0.5, "power": 10}
    assert valve.dead_bands == north.dead_bands == {"voltage": 0.5}


def test_a_journal_of_a_file_is_made_with_its_keys(tmp_path: Path) -> None:
    path = written(tmp_path, SIMPLE)
    assert load(path).made_journal() is None
    path.write_text(f'journal = "{tmp_path}/fleet.db"\n{SIMPLE}')
    journal = load(path).made_journal()
    assert journal is not None
    assert journal.path == f"{tmp_path}/fleet.db"


def test_a_file_with_every_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MQTT_PASSWORD", "secret")
    # One unit has the bands of the defaults that it reads; one has no map of these.
    fleet = FLEET.replace("dead_bands = {voltage = 0.5, power = 10}", "")
    fleet = fleet.replace("[[device]]", "[[device]]\ndead_bands = {power = 10}", 1)
    file = load(written(tmp_path, fleet))
    pump, valve, own, north = file.devices
    assert [each.name for each in file.devices] == ["pump", "valve", "own", "north 1"]
    assert (pump.unit, pump.interval, pump.timeout) == (3, 2.5, None)
    assert pump.labels == {"site": "here", "line": "A"}
    assert pump.names == ("voltage", "power")
    assert pump.dead_bands == {"power": 10}
    assert (valve.names, valve.on_change, valve.zone) == (("voltage",), True, "east")
    assert (valve.timeout, valve.spacing) == (0.5, 0.1)
    assert own.map["level"] == Point("level", "input_registers", 7, scale=0.01)
    assert own.dead_bands == {"level": 2}
    assert (north.unit, north.interval, north.names) == (4, 7.5, ("voltage",))
    assert north.labels == {"site": "here"}
    assert pump.map is valve.map is north.map
    (json_kind, json_keys), (_, mqtt_keys) = file.outputs
    assert (json_kind, json_keys) == ("json", {"path": str(tmp_path / "readings.jsonl")})
    assert mqtt_keys["password"] == "secret"
    assert "secret" not in repr(file)
    fleet_of_it = Fleet.from_file(tmp_path / "fleet.toml")
    assert set(fleet_of_it.statistics.outputs) == set()
    assert [type(each) for each in file.made_outputs()][1] is Mqtt


def test_the_example_of_the_source_tree_can_be_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MQTT_PASSWORD", "INFLUX_PASSWORD", "INFLUX_TOKEN"):
        monkeypatch.setenv(name, "secret")
    file = load(EXAMPLE)
    assert len(file.devices) > 2
    assert {kind for kind, _ in file.outputs} == {"json", "csv", "influx", "mqtt"}


def test_the_example_of_the_source_tree_has_every_key() -> None:
    text = EXAMPLE.read_text()
    given = tomllib.loads(re.sub(r"(?m)^# (?=\w+ = )", "", text))  # also what is commented out
    assert set(FILE) == set(given)
    assert set(ENGINE) == set(given["engine"])
    assert set(TABLE) == {key for table in [given["defaults"], *given["device"]] for key in table}
    for kind in KINDS:
        tables = given["output"][kind]
        found = {key for each in ([tables] if isinstance(tables, dict) else tables) for key in each}
        assert found >= set(output_keys(kind)) - {"buffer"}, kind
    assert "buffer = " in text  # all kinds have it
    for secret in SECRET:
        assert f"or {secret}_file = " in text


SIMPLE = '[[device]]\nname = "a"\nurl = "tcp://h"\nmap = "meter.csv"\n'


# Below the keys of SIMPLE, in line 5.
WRONG_KEYS = {
    "unit = 256": "unit must be in 0..255, not 256",
    "interval = 0": "interval must be in 0.01..86400 seconds, not 0",
    "on_change = 1": "on_change must be true or false, not 1",
    "items = ['volts']": "items[0]: the map has no point 'volts' to",
    "items = ['reset']": "items[0]: the map has no point 'reset' to",
    "items = 'power'": "items must be a list of names, not str",
    "dead_bands = {x = 1}": "dead_bands.x: no point of this name",
    "at_least = 0": "at_least must be in 0.01..86400 seconds",
    "dead_bands = {power = -1}": "dead_bands.power must be 0 or more",
    "labels = {x = 1}": "labels.x must be text, not int",
    "max_registers = 1": "max_registers: items['power']: float32 takes",
    "[[device.point]]\nname='x'\ntable='coils'\naddress=1": "point: the device has a map already",
}

# In place of a text in SIMPLE.
WRONG_VALUES = [
    ("tcp://h", "http://h", 3, "url: 'http://h': the scheme must"),
    ("tcp://h", "tcp://h?unit=3", 3, "url: 'tcp://h?unit=3' must not contain unit"),
    ("tcp://h", "rtu+tcp://h?max_in_flight=4", 3, "url: max_in_flight must be 1"),
    ('"tcp://h"', '"rtu:///dev/x"\nunit = 0', 4, "unit must not be 0 on this"),
    ("meter", "metre", 4, "map: cannot read"),
    ('"meter.csv"', "7", 4, "map must be the name of a file, not 7"),
    (
        'map = "meter.csv"',
        "[[device.point]]\nname = 'x'\ntable = 'coils'\naddress = 70000",
        *(7, "point[0].address must be in 0..65535"),
    ),
]

BROKER = "[output.mqtt]\nurl = 'mqtt://x'\n"

# Below these, in line 3.
WRONG_KEYS_OF_A_BROKER = {
    "discovery = 'openhab'": "discovery must be 'homeassistant', not 'openhab'",
    "discovery = true": "discovery must be 'homeassistant', not True",
    "topic = 'homeassistant/{device}/{name}'\ndiscovery = 'homeassistant'": (
        "topic must not begin with homeassistant/, where configurations for discovery are"
    ),
    "status = 'homeassistant/status'\ndiscovery = 'homeassistant'": "status must not begin with",
    "status = ''\ndiscovery = 'homeassistant'": "status must not be empty with discovery",
    "retain = false\ntopic = 'p/{device}'\ndiscovery = 'homeassistant'": (
        "retain must be true with discovery and a topic without {name}"
    ),
    "device_status = 'p/{device}/{name}'\ndiscovery = 'homeassistant'": "device_status must hold",
    "qos = 2": "qos must be in 0..1",
    "password = 'secret'": "password must not be written in the file: use ${NAME}",
    "password = '${NOT_THERE}'": "password: ${NOT_THERE}: the environment has no such variable",
    "password_file = 'none'": "password_file: cannot read",
}

# Above SIMPLE.
WRONG_TABLES = [
    ("x = 3", 1, "x: no such key; allowed are journal, keep, journal_size, devices, encoding,"),
    ("devices = 'none.csv'", 1, "devices: cannot read"),
    ("devices = ['a']", 1, "devices must be the name of a file, not"),
    ("[defaults]\nname = 'x'", 2, "defaults.name: no such key"),
    ("[engine]\nleese = 3", 2, "engine.leese: no such key"),
    ("[[device]]\nnam = 3", 2, "device[0].nam: no such key; allowed are name, url, map, unit"),
    ("[[device]]\nname = 'b'", 1, "device[0].url is missing"),
    ("[output.jsn]", 1, f"output.jsn: no such key; allowed are {', '.join(KINDS)}"),
    ("[output.json]\npth = 'x'", 2, "output.json.pth: no such key; allowed are path"),
    (
        "[[output.csv]]\n[[output.csv]]\npth = 1",
        3,
        "output.csv[1].pth: no such key; allowed are path",
    ),
    ("[output.json]\npath = 7", 2, "output.json.path must be text"),
    ("[output.mqtt]\nuser = 'x'", 1, "output.mqtt.url is missing"),
    ("[output.influx]\ntoken = 'secret'", 2, "output.influx.token must not be written in the file"),
]


@pytest.mark.parametrize(
    ("fleet", "line", "said"),
    [
        ("", None, "device must hold at least one table: [[device]]"),
        ("device = 3", 1, "device must be a list of tables"),
        (SIMPLE + SIMPLE, 6, "device[1].name: 'a' is also the name of another"),
        (
            SIMPLE + SIMPLE.replace('"a"', '"b"').replace("//h", "//h?timeout=3"),
            *(7, "device[1].url: 'a' has other options for the same connection: tcp://h:502"),
        ),
        *((SIMPLE + key, 5, f"device[0].{said}") for key, said in WRONG_KEYS.items()),
        *(
            (SIMPLE.replace(old, new), line, f"device[0].{said}")
            for old, new, line, said in WRONG_VALUES
        ),
        *(
            (f"{BROKER}{key}\n{SIMPLE}", 3, f"output.mqtt.{said}")
            for key, said in WRONG_KEYS_OF_A_BROKER.items()
        ),
        *((f"{table}\n{SIMPLE}", line, said) for table, line, said in WRONG_TABLES),
    ],
)
def test_a_wrong_value_is_named_with_its_line(tmp_path, fleet, line, said) -> None:
    path = written(tmp_path, fleet)
    with pytest.raises(FleetFileError) as caught:
        load(path)
    text = str(caught.value)
    place = f"{path}, line {line}: " if line else f"{path}: "
    assert text.startswith(place)
    assert said in text
    assert "\n" not in text
    assert "secret" not in text


ROWS = "name,url,unit,map\na,tcp://h,1,meter.csv\n"


@pytest.mark.parametrize(
    ("csv", "said"),
    [
        ("nam,url\nx,y\n", "line 1: no such column: 'nam'; allowed are name, url, map, unit"),
        ("name,name\nx,y\n", "line 1: two columns name"),
        (ROWS + "b,tcp://i,x,meter.csv\n", "line 3, column unit: unit must be a whole number"),
        (
            ROWS + "b,tcp://i,999,meter.csv\n",
            "line 3, column unit: unit must be in 0..255, not 999",
        ),
        (ROWS + "b,,1,meter.csv\n", "line 3, column url: url is missing"),
        (ROWS + "b,tcp://i,1,none.csv\n", "line 3, column map: map: cannot read"),
        (
            ROWS + "\n# x\na,tcp://i,1,meter.csv\n",
            "line 5, column name: name: 'a' is also the name of another device",
        ),
        (ROWS + "b,tcp://i,1,meter.csv,more\n", "line 3: 5 cells below 4 headings"),
        (ROWS + 'b,"tcp\n', "line 3: invalid CSV"),
        (ROWS + "#12,tcp://i,1,meter.csv\n", "line 3: quote '#12' if it is a name, or put a"),
        ("name,url,map,interval\na,tcp://h,meter.csv,1_0\n", "interval must be a number such"),
        ('name,url,map,interval\na,tcp://h,meter.csv,"1,5"\n', "with a point, not a comma, not"),
        ("name,url,map\na,tcp://h,\x1bmeter.csv\n", "line 2: contains the control character 0x1b"),
    ],
)
def test_a_wrong_cell_in_a_list_of_devices_is_named(tmp_path: Path, csv: str, said: str) -> None:
    path = written(tmp_path, 'devices = "more.csv"', csv)
    with pytest.raises(FleetFileError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}, line 1: devices: {tmp_path / 'more.csv'}, line ")
    assert said in str(caught.value)


SPREADSHEET = "Geräte 2026;;;\n\nname;url;map;interval;labels.site\na;tcp://h;meter.csv;1,5;Köln\n"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (SPREADSHEET.encode(), []),
        (SPREADSHEET.encode("cp1252"), ["read as cp1252"]),
        (SPREADSHEET.encode("utf-16"), ["read as utf-16, because it is not UTF-8"]),
        (b"sep=;\r\n" + SPREADSHEET.encode("utf-8-sig")[3:].replace(b"\n", b"\r\n"), []),
    ],
    ids=["UTF-8", "cp1252", "UTF-16", "sep"],
)
def test_a_list_of_devices_is_read_as_spreadsheets_save_it(tmp_path, data, said) -> None:
    encoding = 'encoding = "cp1252"\n' if "read as cp1252" in said else ""
    path = written(tmp_path, f'{encoding}devices = "more.csv"')
    (tmp_path / "more.csv").write_bytes(data)
    file = load(path)
    (device,) = file.devices
    assert (device.interval, device.labels) == (1.5, {"site": "Köln"})
    notes = [*said, "rows above the headings that are skipped: 1"]
    assert file.notes == tuple(f"{tmp_path / 'more.csv'}: {each}" for each in notes)


def test_a_list_of_devices_is_a_table_in_markdown_or_a_spreadsheet(tmp_path: Path) -> None:
    (tmp_path / "more.md").write_text(
        "# Pumps\n\n| name | url | map | unit |\n|---|---|---|--:|\n"
        "| a | tcp://192.0.2.1 | sdm120 | 7 |\n"
    )
    openpyxl = importlib.import_module("openpyxl")  # which has no types
    book = openpyxl.Workbook()
    book.active.append(["name", "url", "map", "unit"])
    book.active.append(["a", "tcp://192.0.2.1", "sdm120", 7])
    book.save(tmp_path / "more.xlsx")
    for name in ("more.md", "more.xlsx"):
        (device,) = load(written(tmp_path, f'devices = "{name}"')).devices
        assert (device.name, device.unit) == ("a", 7)


def test_all_mistakes_in_devices_are_found_at_once(tmp_path: Path) -> None:
    rows = ROWS + "b,tcp://i,x,meter.csv\nc,,1,meter.csv\na,tcp://i,2,meter.csv\n"
    table = SIMPLE.replace('"a"', '"d"') + "unit = 256\n"
    path = written(tmp_path, f"devices = 'more.csv'\n{table}", rows)
    with pytest.raises(FleetFileError) as caught:
        load(path)
    found = [str(each) for each in (caught.value, *caught.value.others)]
    wanted = ["device[0].unit", "line 3, column unit", "line 4, column url", "line 5, column name"]
    for said, text in zip(wanted, found, strict=True):
        assert text.startswith(f"{path}, line ")
        assert said in text


def test_an_error_has_no_more_than_a_page_of_mistakes(tmp_path: Path) -> None:
    path = written(tmp_path, 'devices = "more.csv"', ROWS + "b,tcp://i,x,meter.csv\n" * 100)
    with pytest.raises(FleetFileError) as caught:
        load(path)
    assert len(caught.value.others) == 19


@pytest.mark.parametrize("where", ["[[device]]", "[defaults]"])
def test_columns_of_a_map_are_named(tmp_path: Path, where: str) -> None:
    points = MAP.replace("name,", "Mesure,", 1)
    named = "columns = {name = 'Mesure'}\n"
    fleet = SIMPLE + named if where == "[[device]]" else f"[defaults]\n{named}{SIMPLE}"
    (device,) = load(written(tmp_path, fleet, points=points)).devices
    assert "voltage" in device.map
    with pytest.raises(FleetFileError, match="no column name"):
        load(written(tmp_path, SIMPLE, points=points))
    wrong = fleet.replace("'Mesure'", "7")
    with pytest.raises(FleetFileError, match=r"columns\.name must be the heading of a column"):
        load(written(tmp_path, wrong, points=points))


def test_ten_thousand_devices_are_read_in_time(tmp_path: Path) -> None:
    rows = "name,url,unit,map\n" + "".join(
        f"device {at},tcp://10.0.{at // 2560}.{at // 10 % 256},{at % 10 + 1},meter.csv\n"
        for at in range(10_000)
    )
    file = load(written(tmp_path, 'devices = "more.csv"', rows))
    assert len(file.devices) == 10_000
    assert len(by_connection(file.devices)) == 1000
    assert len({id(each.map) for each in file.devices}) == 1


def test_a_file_for_the_map_with_a_mistake_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, SIMPLE, points=MAP.replace("float32", "float33"))
    with pytest.raises(FleetFileError, match=re.escape("meter.csv, line 3, column type: ")):
        load(path)


def test_devices_come_back_from_json_as_they_were() -> None:
    other = RegisterMap([Point("ä", "coils", 3, access="read", description="x")])
    devices = [
        meter("a", "tcp://192.0.2.1", unit=3, items=("power",), dead_bands={"power": 2.5}),
        meter("b", "tcp://192.0.2.1", timeout=2.0, labels={"k": "v"}, zone="z", on_change=True),
        DeviceConfig("c", "rtu:///dev/ttyUSB0?parity=N", other, gap=5, spacing=0.2),
    ]
    text = devices_to_json(devices)
    again = devices_from_json(text)
    assert again == devices
    assert devices_to_json(again) == text
    assert again[0].map is again[1].map is devices_from_json(text)[0].map
    assert again[0] != meter("a", "tcp://192.0.2.1", unit=4)
    assert text.count("voltage") == 1
    assert devices_from_json(devices_to_json([])) == []
    json.loads(text)


@pytest.mark.parametrize(
    "text",
    [
        *("", "{}", "[]", '{"maps": [], "devices": [{"map": 0}]}', "[" * 100_000),
        *('{"maps": [[]], "devices": [3]}', '{"maps": [], "devices": [{"name": "a"}]}'),
        *('{"maps": [7], "devices": []}', '{"maps": [[]], "devices": [{"map": 0, "url": []}]}'),
    ],
)
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="the text does not describe devices"):
        devices_from_json(text)


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"name": ""}, "name must have 1..100 characters"),
        ({"name": "a\nb"}, "name must have"),
        ({"name": "x" * 101}, "name must have"),
        ({"name": 7}, "name must be text"),
        ({"map": {}}, "map must be a RegisterMap, not dict"),
        ({"spacing": "1"}, "spacing must be a number of seconds"),
        ({"timeout": -1}, "timeout must be in 0.001..86400 seconds"),
        ({"unit": "1"}, "unit must be an integer"),
        ({"zone": None}, "zone must be text"),
        ({"labels": []}, "labels must be a table"),
        ({"dead_bands": 3}, "dead_bands must be a table"),
        ({"dead_bands": {"power": float("nan")}}, "dead_bands.power must be 0 or more, not nan"),
        ({"url": None}, "url: url must be a string"),
        ({"map": RegisterMap([Point("x", "coils", 0, access="write")])}, "map has no point that"),
    ],
)
def test_bad_device_is_named(keys: Any, named: str) -> None:
    with pytest.raises((TypeError, ValueError), match=named):
        DeviceConfig(**{"name": "a", "url": "tcp://h", "map": METER, **keys})
