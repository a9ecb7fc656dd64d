"""Register maps from files: TOML as people write it, CSV of vendors, and what is neither."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from libmodbus_py import MapError, Point, RegisterMap, load_map
from libmodbus_py.maps.list_words import ListOptions
from libmodbus_py.maps.map_file import contents_of, remarks
from libmodbus_py.tools.files.map_texts import csv_text, toml_text
from tests.support.cases import each_case
from tests.support.golden import Refused

H, I = "holding_registers", "input_registers"  # noqa: E741


def loaded(path: Path, content: str | bytes, name: str = "meter.csv") -> RegisterMap:
    data = content if isinstance(content, bytes) else content.encode()
    (path / name).write_bytes(data)
    return load_map(path / name)


# What German Excel saves: a title, an empty row, decimal commas, and its own encoding.
GERMAN = (
    "Zähler Halle 3;;;;\r\n;;;;\r\n"
    "Bezeichnung;Register;Datentyp;Faktor;Einheit\r\n"
    "Außentemperatur;40001;S16;0,1;°C\r\nZählerstand;40002;U32;-2,5e-3;kWh\r\n"
)
NAMED = {"scale": "Faktor"}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("begin", ["", "sep=;\r\n"])
def test_a_spreadsheet_as_excel_saves_it(tmp_path: Path, encoding: str, begin: str) -> None:
    path = tmp_path / "Zähler.csv"
    path.write_bytes((begin + GERMAN).encode(encoding))
    options = {"encoding": encoding} if encoding == "cp1252" else {}
    assert list(load_map(path, columns=NAMED, **options).values()) == [
        Point("Außentemperatur", H, 0, type="int16", scale=0.1, units="°C"),
        Point("Zählerstand", H, 1, type="uint32", scale=-0.0025, units="kWh"),
    ]
    notes = contents_of(path, 1, ListOptions(columns=NAMED, **options)).notes
    of_encoding = {
        "utf-16": ["read as utf-16, because it is not UTF-8"],
        "cp1252": ["read as cp1252"],
    }
    assert notes == [
        *of_encoding.get(encoding, []),
        "rows above the headings that are skipped: 1",
        "Register has references: 40001 is holding register 0",
    ]


def test_a_named_column_must_exist(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("name,address\na,40001\n")
    with pytest.raises(MapError, match="line 1: no column Faktor, which is named for scale"):
        load_map(path, columns={"scale": "Faktor"})
    with pytest.raises(ValueError, match=r"columns must name some of name, .*, not 'faktor'"):
        load_map(path, columns={"faktor": "Faktor"})
    toml = tmp_path / "map.toml"
    toml.write_text("")
    with pytest.raises(ValueError, match="columns and such are for lists"):
        load_map(toml, columns={"name": "Bezeichnung"})


@each_case("table", sorted((Path(__file__).parent / "tables").glob("*.csv")))
def test_tables_of_vendors_are_equal_to_the_maps_beside_them(table: Path) -> None:
    """Beside each table stands what it means, in TOML."""
    assert list(load_map(table).values()) == list(load_map(table.with_suffix(".toml")).values())


HEAD = "name,table,address,type,scale,access\n"


@pytest.mark.parametrize("kind", ["csv", "toml"])
def test_errors_of_files_name_the_mistake(kind: str, tmp_path: Path, refused: Refused) -> None:
    def load_without_folder(content: str | bytes) -> None:
        try:
            loaded(tmp_path, content, f"meter.{kind}")
        except MapError as error:
            raise ValueError(str(error).replace(str(tmp_path), "FOLDER")) from None

    refused(f"wrong_{kind}.txt", load_without_folder)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"^cannot read .*meter\.csv: No such file or directory$"):
        load_map(tmp_path / "meter.csv")
    with pytest.raises(MapError, match=r"meter\.ods: a register map must end with one of \.toml"):
        load_map(str(tmp_path / "meter.ods"))
    (tmp_path / "dir.csv").mkdir()
    with pytest.raises(MapError, match=r"^cannot read .*dir\.csv: Is a directory$"):
        load_map(tmp_path / "dir.csv")


def test_all_mistakes_are_found_up_to_a_number(tmp_path: Path) -> None:
    (tmp_path / "meter.csv").write_text(HEAD + "a,coils,x\nb,coils,1\nc,coil,70000\n" * 9)
    contents = contents_of(tmp_path / "meter.csv", most=5)
    assert [mistake.place[1:] for mistake in contents.mistakes] == [
        (2, "address"),
        (4, "address"),
        (5, "address"),
        (6, "name"),
        (7, "address"),
    ]


def test_a_suspicious_value_is_noted(tmp_path: Path) -> None:
    (tmp_path / "meter.csv").write_text(
        "name,address,table,type,scale,Vendor's own,More\n"
        "whole,40001,holding,uint32,-2,,\n"
        "low,40002,holding,,,,\n"
        "other,40001,input,,,,\n"
    )
    notes = list(remarks(contents_of(tmp_path / "meter.csv", most=1)))
    assert notes[0] == "columns that mean nothing here: Vendor's own, More"
    assert notes[1].startswith("all addresses of holding_registers are in 40001..49999: if these")
    assert notes[2:] == ["line 3: low overlaps whole at holding_registers 40002"]


PRINTABLE = st.characters(exclude_categories=("C", "Z"))
WORDS = st.text(PRINTABLE, min_size=1, max_size=20).filter(lambda word: not word.startswith("#"))
NUMBERS = st.floats(-1e6, 1e6).filter(lambda each: abs(each) > 1e-6) | st.integers(1, 1000)
POINTS = st.builds(
    Point,
    name=WORDS,
    table=st.sampled_from([H, I]),
    address=st.integers(0, 60000),
    count=st.integers(1, 100),
    type=st.sampled_from([None, "int16", "uint64", "float32", "bcd32"]),
    order=st.sampled_from(["ABCD", "CDAB", "BADC", "DCBA"]),
    scale=NUMBERS,
    offset=NUMBERS,
    units=st.just("") | WORDS,
    access=st.just("read"),
    minimum=st.none() | st.floats(-1e6, 0),
    maximum=st.none() | st.integers(0, 10**6),
    description=st.just("") | WORDS,
)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(POINTS, min_size=1, max_size=5, unique_by=lambda point: point.name))
def test_a_written_map_is_the_same_when_it_is_read(tmp_path: Path, points: list[Point]) -> None:
    assert list(loaded(tmp_path, csv_text(points)).values()) == points
    assert list(loaded(tmp_path, toml_text(points), "METER.TOML").values()) == points


JUNK = st.sampled_from(
    [
        *(b"name", b"address", b"table", b"type", b"scale", b"40001", b"holding", b"float32"),
        *(b"0x10", b'"', b",", b";", b"\t", b"\r", b"\n", b"=", b"1/3", b"\xef\xbb\xbf", b"\0"),
        *(b"\xff", b"[["),
    ]
)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300) | st.lists(JUNK, max_size=60).map(b"".join))
@example(b"name,address\n" + b"," * 200_000)
@example(b"name,address\na," + b"4" * 400_000)
@example(b"name,address,fc\na,1," + b"fc0x " * 80_000)
def test_any_other_content_is_a_mistake(tmp_path: Path, content: bytes) -> None:
    messages: list[str] = []
    for name in ("meter.csv", "meter.toml"):
        try:
            loaded(tmp_path, content, name)
        except MapError as error:
            messages.append(str(error))
    assert all(len(message) < 1000 for message in messages)
