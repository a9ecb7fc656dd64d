"""
Register lists as vendors and programs write them, rebuilt in small: each loads with what its
messages name, and gives the values that its origin gives.

The shapes are those of ioBroker's modbus-templates (and the words of its adapter's README and
source), of NIBE's ModbusManager and menus (values as the package nibe decodes them), of Victron's
register list and attributes.csv, of modpoll's examples, and of lists on vendors' pages.
"""

import importlib
import json
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Device, Fleet, MapError, RegisterMap, load, load_map
from libmodbus_py.maps.list_words import ListOptions
from libmodbus_py.maps.map_file import contents_of
from tests.support.cases import each_case
from tests.support.golden import Refused

# The lists, by the names of their files.
HERE = Path(__file__).parent
TEXTS = {path.stem: path.read_bytes().decode() for path in (HERE / "lists").iterdir()}

# A list, what is replaced in it, the options with which it loads, what each message names before
# they are given, and the registers of points, with their values.
LISTS: list[tuple[str, dict[str, Any], list[str], list[tuple[str, list[int], Any]]]] = [
    (TEXTS[name].replace(*replaced), *others)
    for name, replaced, *others in json.loads((HERE / "lists.json").read_bytes())
]


def written(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / f"list{'.md' if '|---' in text else '.csv'}"
    path.write_bytes(text.encode(encoding))
    return path


@each_case(("text", "options", "names", "registers"), LISTS)
def test_a_list_has_the_values_of_its_source(tmp_path, text, options, names, registers) -> None:
    map = load_map(written(tmp_path, text, options.get("encoding", "utf-8")), **options)
    for name, cells, value in registers:
        assert map[name].decode(cells) == value, name
    assert len(options) <= 3


@each_case(("text", "options", "names", "registers"), LISTS)
def test_a_message_names_each_missing_option(tmp_path, text, options, names, registers) -> None:
    path = written(tmp_path, text, options.get("encoding", "utf-8"))
    messages = []
    for name in ("nothing", *options):
        less = {key: options[key] for key in options if key != name} if name in options else {}
        try:
            load_map(path, **less)
        except MapError as error:
            messages.append(str(error))
    for option in names:
        assert any(option in message for message in messages), (option, messages)


def test_addresses_tables_and_accesses_of_lists(tmp_path: Path) -> None:
    def of(name: str, **options: Any) -> list[tuple[str, int, str]]:
        points = load_map(
            written(tmp_path, TEXTS[name], options.get("encoding", "utf-8")), **options
        ).values()
        return [(point.table, point.address, str(point.access)) for point in points]

    holding = "holding_registers"
    assert of("nibe_f", origin="nibe")[:2] == [(holding, 3, "read"), (holding, 7010, "read_write")]
    assert of("nibe_s", origin="nibe")[1:] == [
        ("input_registers", 46, "read"),
        (holding, 227, "read_write"),
    ]
    assert of("old_modpoll", origin="modpoll")[0] == (holding, 46011, "read")
    assert of("chinese", encoding="gbk", columns={"scale": "系数"})[1] == (
        holding,
        17,
        "read_write",
    )
    assert of("meter", origin="iobroker", table="input")[0] == ("input_registers", 40001, "read")
    assert of("meter", origin="iobroker", first_address="reference")[0] == (
        holding,
        0,
        "read_write",
    )


def test_bounds_and_initial_values_are_raw_where_the_source_of_a_list_says_so(tmp_path) -> None:
    map = load_map(written(tmp_path, TEXTS["nibe_f"]), origin="nibe")
    minutes, offset = map["Degree minutes"], map["Offset"]
    assert (minutes.minimum, minutes.maximum) == (-3000, 3000)
    assert (offset.minimum, offset.maximum, offset.initial) == (-10, 10, 2)
    assert map["BT1 Outdoor"].minimum is None
    assert Device.of_map(map)["Offset"] == 2
    assert Device.of_map(map, {"Offset": 3})["Offset"] == 3


def test_initial_values_come_from_a_column(tmp_path: Path) -> None:
    text = (
        "name,table,address,type,scale,initial value\n"
        "a,holding,0,uint16,0.1,21.5\nb,holding,1,string:4,,007\nc,coils,0,,,true\nd,coils,1,,,\n"
    )
    device = Device.of_map(written(tmp_path, text))
    assert [device[name] for name in "abcd"] == [21.5, "007", True, False]


HEAD = "name,table,address,type"


def load_text(folder: Path, text: str) -> None:
    """Load a list, whose errors name its folder as FOLDER."""
    try:
        load_map(written(folder, text), **({"table": "holding"} if text[0] == "_" else {}))
    except MapError as error:
        raise ValueError(str(error).replace(str(folder), "FOLDER")) from None


def test_a_value_that_would_be_lost_is_refused_with_its_line(tmp_path: Path, refused: Refused):
    refused("losses.txt", lambda text: load_text(tmp_path, text))


def test_an_ambiguous_cell_is_refused_with_the_option_that_decides(
    tmp_path: Path, refused: Refused
) -> None:
    refused("two_meanings.txt", lambda text: load_text(tmp_path, text))


# Texts, the options that say what is meant, and the arguments of their point.
MEANINGS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    *json.loads((HERE / "meanings.json").read_bytes()),
    (
        f'{HEAD},states\na,holding,0,u16,"0 = off;\n1 = on, or so"\n',
        {},
        {"states": {0: "off", 1: "on, or so"}},
    ),
]


@each_case(("text", "options", "arguments"), MEANINGS)
def test_an_option_resolves_the_ambiguity(tmp_path, text, options, arguments) -> None:
    (point,) = load_map(written(tmp_path, text), **options).values()
    assert {name: getattr(point, name) for name in arguments} == arguments


def test_the_number_of_registers_is_checked(tmp_path: Path) -> None:
    text = f"{HEAD},Number of registers\na,holding,0,u16,2\n"
    with pytest.raises(MapError, match="uint16 has 1, and the list says 2"):
        load_map(written(tmp_path, text))
    with pytest.raises(MapError, match="int32 has 2, and the list says 3"):
        load_map(written(tmp_path, "name,address,type\na,40001-40003,int32\n"))


def test_rows_that_no_map_can_express_are_left_out_and_noted_with_their_line(tmp_path: Path):
    contents = contents_of(written(tmp_path, TEXTS["modpoll"]), 20, ListOptions(origin="modpoll"))
    assert list(contents.points) == ["reg01", "reg10", "reg13"]
    (mistake,) = contents.mistakes
    assert mistake.place.line == 4
    assert "write a row for each" in str(mistake)


def test_a_known_list_format_needs_all_of_its_headings(tmp_path: Path) -> None:
    assert "read as a list of nibe, whose headings it has" in (
        contents_of(written(tmp_path, TEXTS["nibe_f"]), 1).notes
    )
    with pytest.raises(MapError, match=r"column Size has two meanings.*--from nibe reads such"):
        load_map(written(tmp_path, TEXTS["nibe_f"].replace("Default;", "Usual;")))


def test_repeated_names_get_their_address(tmp_path: Path) -> None:
    contents = contents_of(written(tmp_path, TEXTS["nibe_f"]), 1, ListOptions(origin="nibe"))
    assert "names that occur twice have their address behind: 8, 9" in contents.notes


WORDS = {
    "int16": "INT16 SINT16 S16 short Signed16 INT_16 int16_t S_WORD INT16S s16",
    "uint16": "UINT16 INT16U U16 WORD ushort UInt_16 uint16_t U_WORD ENUM16 HEX16 u16",
    "int32": "INT32 DINT S32 S_DWORD SINT32 INT32S",
    "uint32": "UINT32 UDINT U32 DWORD U_DWORD INT32U uint32_t",
    "int64": "INT64 LINT S64 INT64S",
    "uint64": "UINT64 U64 INT64U LWORD QWORD U_QWORD",
    "float32": "FLOAT REAL FLOAT32 F32 FP32 single IEEE754 float_32 Float-32",
    "float64": "DOUBLE LREAL FLOAT64 FP64",
    "bits16": "BITFIELD16 bitmap BIT16",
}


@each_case("type", list(WORDS))
def test_words_for_types_in_lists_are_understood(tmp_path: Path, type: str) -> None:
    for word in WORDS[type].split():
        (point,) = load_map(written(tmp_path, f"{HEAD}\na,holding,0,{word}\n")).values()
        assert (point.type, point.order, point.byte) == (type, "ABCD", None), word


ORDERS = [
    ("floatsw", "float32", "CDAB"),
    ("FP32_R", "float32", "CDAB"),
    ("U_DWORD_R", "uint32", "CDAB"),
    ("int32 BADC", "int32", "BADC"),
    ("float32_dcba", "float32", "DCBA"),
    ("uint16le", "uint16", "DCBA"),
]


@each_case(("word", "type", "order"), ORDERS)
def test_words_of_types_with_an_order(tmp_path: Path, word: str, type: str, order: str) -> None:
    (point,) = load_map(written(tmp_path, f"{HEAD}\na,holding,0,{word}\n")).values()
    assert (point.type, point.order) == (type, order)


@pytest.mark.parametrize(("word", "value"), [("u8", 0xFB), ("INT8", -5), ("UINT8", 0xFB)])
def test_a_type_of_one_byte_is_the_low_byte(tmp_path: Path, word: str, value: int) -> None:
    (point,) = load_map(written(tmp_path, f"{HEAD}\na,holding,0,{word}\n")).values()
    assert point.decode([0x01FB]) == value


def spreadsheet(path: Path, rows: list[list[Any]]) -> Path:
    openpyxl = importlib.import_module("openpyxl")
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.create_sheet("More").append(["a"])
    book.save(path)
    return path


def test_a_spreadsheet_is_a_list(tmp_path: Path) -> None:
    rows = [
        ["Meter", None, None, None],
        [],
        ["Name", "Register\naddress", "Type", "Multiplier", "Unit"],
        ["Voltage, L1", 40001, "U16", 0.1, "V"],
        ["# of starts", 40002.0, "U32", 1, None],
    ]
    path = spreadsheet(tmp_path / "list.xlsx", rows)
    map = load_map(path)
    assert map["Voltage, L1"].decode([2305]) == 230.5
    assert map["# of starts"].address == 1
    contents = contents_of(path, 1)
    assert contents.notes[0] == "read sheet Sheet, not More"
    with pytest.raises(MapError, match="read sheet More, not Sheet: --list sheet=NAME"):
        load_map(path, sheet="More")
    with pytest.raises(MapError, match="sheet must be one of Sheet, More, not 'x'"):
        load_map(path, sheet="x")
    with pytest.raises(MapError, match="no column name"):
        load_map(path, sheet="More")


def test_merged_cells_count_in_each_of_their_rows(tmp_path: Path) -> None:
    rows = [
        ["Name", "Register", None, "Type"],
        [None, "Address", "Quantity", None],
        ["a", 40001, 1, "S16"],
        ["b", 40002, 1, None],
    ]
    path = spreadsheet(tmp_path / "list.xlsx", rows)
    openpyxl = importlib.import_module("openpyxl")
    book = openpyxl.load_workbook(path)
    for cells in ("A1:A2", "B1:C1", "D1:D2", "D3:D4"):
        book.active.merge_cells(cells)
    book.save(path)
    assert [(point.address, point.type) for point in load_map(path).values()] == [
        (0, "int16"),
        (1, "int16"),
    ]


def test_a_broken_spreadsheet_is_refused(tmp_path: Path) -> None:
    (tmp_path / "list.xlsx").write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(MapError, match=r"list\.xlsx: is no spreadsheet"):
        load_map(tmp_path / "list.xlsx")


def test_defaults_of_a_map_in_toml(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(
        '[defaults]\ntable = "input_registers"\norder = "CDAB"\ntype = "float32"\n'
        "first_address = 1\n"
        '[[point]]\nname = "a"\naddress = 1\n[[point]]\nname = "b"\naddress = 3\norder = "ABCD"\n'
    )
    map: RegisterMap = load_map(tmp_path / "map.toml")
    assert [(point.table, point.address, point.type, point.order) for point in map.values()] == [
        ("input_registers", 0, "float32", "CDAB"),
        ("input_registers", 2, "float32", "ABCD"),
    ]


def test_bounds_and_initial_values_in_maps_are_checked(tmp_path, capsys) -> None:
    from libmodbus_py.cli.main import main

    (tmp_path / "map.toml").write_text(
        '[defaults]\ntable = "holding_registers"\n'
        '[[point]]\nname = "a"\naddress = 0\nrewrite = 30\ninitial = 7\n'
        '[[point]]\nname = "b"\naddress = 1\nstates = { 0 = "off", "1..9" = "on", else = "?" }\n'
    )
    assert main(["map", "check", str(tmp_path / "map.toml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.strip() for line in lines[-3:]] == [
        "1 point with initial values",
        "a is written again each 30 s",
        "b: 0 = off, 1..9 = on, else = ?",
    ]


def test_a_list_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from libmodbus_py.cli.main import main

    path, output = written(tmp_path, TEXTS["modpoll"]), tmp_path / "map.toml"
    assert main(["map", "import", str(path), "--from", "modpoll", "-o", str(output)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"{output}: 3 points, 1 left out"
    assert lines[-1].startswith("  left out: line 4, column type: ")
    assert list(load_map(output).values()) == list(
        contents_of(path, 9, ListOptions(origin="modpoll")).points.values()
    )
    assert main(["map", "import", str(path), "-o", str(tmp_path / "other.toml")]) == 2
    assert "--from modpoll reads such lists" in capsys.readouterr().err


def test_device_files_and_fleets_read_lists_too(tmp_path: Path) -> None:
    (tmp_path / "pump.csv").write_text(TEXTS["nibe_f"])
    (tmp_path / "meter.csv").write_text(f"{HEAD},Factor\nvolts,holding,0,u16,10\n")
    (tmp_path / "device.toml").write_text(
        '[[unit]]\nid = 1\nmap = "pump.csv"\nlist = { origin = "nibe" }\n'
        '[[unit]]\nid = 2\nmap = "meter.csv"\ncolumns = { divisor = "Factor" }\n'
    )
    devices = load(tmp_path / "device.toml").devices
    assert isinstance(devices, dict)
    assert devices[1]["Offset"] == 2
    devices[2]["volts"] = 23.5
    assert devices[2].mapping.holding_registers[0] == 235
    (tmp_path / "fleet.toml").write_text(
        '[defaults]\nlist = { origin = "nibe" }\n'
        '[[device]]\nname = "pump"\nurl = "tcp://192.0.2.1"\nmap = "pump.csv"\n'
        '[[device]]\nname = "meter"\nurl = "tcp://192.0.2.2"\nmap = "meter.csv"\nlist = {}\n'
        'columns = { divisor = "Factor" }\n'
    )
    pump, meter = Fleet.from_file(tmp_path / "fleet.toml")._devices.values()
    assert pump.map["BT1 Outdoor"].decode([215]) == 21.5
    assert meter.map["volts"].scale == 0.1
    (tmp_path / "fleet.toml").write_text(
        '[[device]]\nname = "a"\nurl = "tcp://192.0.2.1"\nmap = "pump.csv"\n'
        'list = { origin = "nib" }\n'
    )
    with pytest.raises(ValueError, match=r"line 5: device\[0\]\.list\.origin must be one of"):
        Fleet.from_file(tmp_path / "fleet.toml")
    (tmp_path / "device.toml").write_text('[[unit]]\nmap = "pump.csv"\nlist = { origin = "nib" }\n')
    with pytest.raises(ValueError, match=r"line 3: unit\[0\]\.list\.origin must be one of"):
        load(tmp_path / "device.toml")
