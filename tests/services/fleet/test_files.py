"""Fleet files: what they say, and what is wrong with them: file, line, key, what is allowed."""

import importlib
import json
import re
import tomllib
from pathlib import Path

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
from tests.support.golden import Refused

EXAMPLE = Path(__file__).parents[3] / "examples" / "fleet.toml"

MAP = """name,table,address,type,scale,unit,access
voltage,holding_registers,0,uint16,0.1,V,read
power,holding_registers,2,float32,,W,read
reset,coils,5,,,,write
"""

FLEET = "\n" + Path(__file__).with_name("fleet.toml").read_text()

CSV = """# a list
name;url;unit;map;items;interval;on_change;labels.site;zone
north 1;tcp://192.0.2.8;4;;voltage;7,5;;;
"""

CSV_RIGHT = CSV.replace("7,5", "7.5").replace("voltage;", "voltage;", 1)


def fleet_in(folder: Path, fleet: str = FLEET, csv: str = CSV_RIGHT, points: str = MAP) -> Path:
    (folder / "meter.csv").write_text(points)
    (folder / "more.csv").write_text(csv)
    (folder / "fleet.toml").write_text(fleet)
    return folder / "fleet.toml"


def test_default_dead_bands_of_points_that_a_device_does_not_read_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TEST_MQTT_PASSWORD", "secret")
    fleet = FLEET.partition('[[device]]\nname = "own"')[0]
    pump, valve, north = load(fleet_in(tmp_path, fleet)).devices
    assert pump.dead_bands == {"voltage": 0.5, "power": 10}
    assert valve.dead_bands == north.dead_bands == {"voltage": 0.5}


def test_a_journal_of_a_file_is_made_with_its_keys(tmp_path: Path) -> None:
    path = fleet_in(tmp_path, SIMPLE)
    assert load(path).make_journal() is None
    path.write_text(f'journal = "{tmp_path}/fleet.db"\n{SIMPLE}')
    journal = load(path).make_journal()
    assert journal is not None
    assert journal.path == f"{tmp_path}/fleet.db"


def test_a_file_with_every_key_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MQTT_PASSWORD", "secret")
    # One unit has the bands of the defaults that it reads; one has no map of these.
    fleet = FLEET.replace("dead_bands = {voltage = 0.5, power = 10}", "")
    fleet = fleet.replace("[[device]]", "[[device]]\ndead_bands = {power = 10}", 1)
    file = load(fleet_in(tmp_path, fleet))
    pump, valve, own, north = file.devices
    assert [device.name for device in file.devices] == ["pump", "valve", "own", "north 1"]
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
    assert [type(make_output) for make_output in file.make_outputs()][1] is Mqtt


def test_the_example_of_the_source_tree_can_be_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MQTT_PASSWORD", "INFLUX_PASSWORD", "INFLUX_TOKEN"):
        monkeypatch.setenv(name, "secret")
    file = load(EXAMPLE)
    assert len(file.devices) > 2
    assert {kind for kind, _ in file.outputs} == {"json", "csv", "influx", "mqtt"}


def test_the_example_of_the_source_tree_has_every_key() -> None:
    text = EXAMPLE.read_text()
    file = tomllib.loads(re.sub(r"(?m)^# (?=\w+ = )", "", text))  # also what is commented out
    assert set(FILE) == set(file)
    assert set(ENGINE) == set(file["engine"])
    assert set(TABLE) == {key for table in [file["defaults"], *file["device"]] for key in table}
    for kind in KINDS:
        tables = file["output"][kind]
        keys = {key for item in ([tables] if isinstance(tables, dict) else tables) for key in item}
        assert keys >= set(output_keys(kind)) - {"buffer"}, kind
    assert "buffer = " in text  # all kinds have it
    for secret in SECRET:
        assert f"or {secret}_file = " in text


SIMPLE = '[[device]]\nname = "a"\nurl = "tcp://h"\nmap = "meter.csv"\n'


def load_texts(folder: Path, *texts: str) -> None:
    """Load a fleet file, whose errors name its folder as FOLDER, and no password."""
    try:
        load(fleet_in(folder, *texts))
    except FleetFileError as error:
        text = str(error).replace(str(folder), "FOLDER")
        raise ValueError(text.replace("secret", "PASSWORD")) from None


def test_a_wrong_value_is_named_with_its_line(tmp_path: Path, refused: Refused) -> None:
    refused("wrong_fleets.txt", lambda fleet: load_texts(tmp_path, fleet))


ROWS = "name,url,unit,map\na,tcp://h,1,meter.csv\n"


def test_a_wrong_cell_in_a_list_of_devices_is_named(tmp_path: Path, refused: Refused) -> None:
    refused("wrong_lists.txt", lambda csv: load_texts(tmp_path, 'devices = "more.csv"', csv))


SPREADSHEET = "Geräte 2026;;;\n\nname;url;map;interval;labels.site\na;tcp://h;meter.csv;1,5;Köln\n"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (SPREADSHEET.encode(), []),
        (SPREADSHEET.encode("cp1252"), ["read as cp1252"]),
        (SPREADSHEET.encode("utf-16"), ["read as utf-16, because it is not UTF-8"]),
        (b"sep=;\r\n" + SPREADSHEET.encode("utf-8-sig")[3:].replace(b"\n", b"\r\n"), []),
    ],
    ids=["UTF-8", "cp1252", "UTF-16", "sep"],
)
def test_a_list_of_devices_is_read_as_spreadsheets_save_it(tmp_path, data, message) -> None:
    encoding = 'encoding = "cp1252"\n' if "read as cp1252" in message else ""
    path = fleet_in(tmp_path, f'{encoding}devices = "more.csv"')
    (tmp_path / "more.csv").write_bytes(data)
    file = load(path)
    (device,) = file.devices
    assert (device.interval, device.labels) == (1.5, {"site": "Köln"})
    notes = [*message, "rows above the headings that are skipped: 1"]
    assert file.notes == tuple(f"{tmp_path / 'more.csv'}: {note}" for note in notes)


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
        (device,) = load(fleet_in(tmp_path, f'devices = "{name}"')).devices
        assert (device.name, device.unit) == ("a", 7)


def test_all_mistakes_in_devices_are_found_at_once(tmp_path: Path) -> None:
    rows = ROWS + "b,tcp://i,x,meter.csv\nc,,1,meter.csv\na,tcp://i,2,meter.csv\n"
    table = SIMPLE.replace('"a"', '"d"') + "unit = 256\n"
    path = fleet_in(tmp_path, f"devices = 'more.csv'\n{table}", rows)
    with pytest.raises(FleetFileError) as caught:
        load(path)
    messages = [str(entry) for entry in (caught.value, *caught.value.others)]
    places = ["device[0].unit", "line 3, column unit", "line 4, column url", "line 5, column name"]
    for place, text in zip(places, messages, strict=True):
        assert text.startswith(f"{path}, line ")
        assert place in text


def test_an_error_has_no_more_than_a_page_of_mistakes(tmp_path: Path) -> None:
    path = fleet_in(tmp_path, 'devices = "more.csv"', ROWS + "b,tcp://i,x,meter.csv\n" * 100)
    with pytest.raises(FleetFileError) as caught:
        load(path)
    assert len(caught.value.others) == 19


@pytest.mark.parametrize("where", ["[[device]]", "[defaults]"])
def test_columns_of_a_map_can_be_named(tmp_path: Path, where: str) -> None:
    points = MAP.replace("name,", "Mesure,", 1)
    option = "columns = {name = 'Mesure'}\n"
    fleet = SIMPLE + option if where == "[[device]]" else f"[defaults]\n{option}{SIMPLE}"
    (device,) = load(fleet_in(tmp_path, fleet, points=points)).devices
    assert "voltage" in device.map
    with pytest.raises(FleetFileError, match="no column name"):
        load(fleet_in(tmp_path, SIMPLE, points=points))
    wrong = fleet.replace("'Mesure'", "7")
    with pytest.raises(FleetFileError, match=r"columns\.name must be the heading of a column"):
        load(fleet_in(tmp_path, wrong, points=points))


def test_ten_thousand_devices_are_read_in_time(tmp_path: Path) -> None:
    rows = "name,url,unit,map\n" + "".join(
        f"device {at},tcp://10.0.{at // 2560}.{at // 10 % 256},{at % 10 + 1},meter.csv\n"
        for at in range(10_000)
    )
    file = load(fleet_in(tmp_path, 'devices = "more.csv"', rows))
    assert len(file.devices) == 10_000
    assert len(by_connection(file.devices)) == 1000
    assert len({id(device.map) for device in file.devices}) == 1


def test_a_wrong_map_file_is_named(tmp_path: Path) -> None:
    path = fleet_in(tmp_path, SIMPLE, points=MAP.replace("float32", "float33"))
    with pytest.raises(FleetFileError, match=re.escape("meter.csv, line 3, column type: ")):
        load(path)


def test_devices_are_the_same_after_json() -> None:
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
def test_text_that_describes_no_devices_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="the text does not describe devices"):
        devices_from_json(text)


def test_an_invalid_device_is_named(refused: Refused) -> None:
    right = {"name": "a", "url": "tcp://h", "map": METER}
    refused("wrong_devices.txt", lambda keys: DeviceConfig(**right | keys))
    unreadable = RegisterMap([Point("x", "coils", 0, access="write")])
    with pytest.raises(ValueError, match="map has no point that"):
        DeviceConfig("a", "tcp://h", unreadable)
