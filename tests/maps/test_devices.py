"""Each file of tests/devices: a map of examples/, its sources, and what answers mean."""

import re
import tomllib
from pathlib import Path
from typing import Any

from libmodbus_py import Client, Device, Mapping, load_map
from libmodbus_py.maps.map_file import contents_of
from libmodbus_py.tools.simulator import example_files
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.cases import each_case

ROOT = Path(__file__).parents[2]
DEVICES = sorted((ROOT / "tests" / "devices").glob("*.toml"))
TABLES = {1: "coils", 2: "discrete_inputs", 3: "holding_registers", 4: "input_registers"}


def answers_of(path: Path) -> list[dict[str, Any]]:
    table = tomllib.loads(path.read_text())
    assert set(table) == {"map", "answers", "answer"}, f"{path}: keys map, answers and [[answer]]"
    assert table["map"] == path.stem, f"{path}: named for its map"
    assert re.match(r"(recorded|computed) ", table["answers"]), f"{path}: answers says of what"
    answers: list[dict[str, Any]] = table["answer"]
    return answers


def cells_of(answer: dict[str, Any]) -> tuple[str, int, list[int]]:
    data = bytes.fromhex(answer["registers"])
    cells = [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]
    return TABLES[answer["function"]], answer["address"], cells


@each_case("path", DEVICES)
def test_answers_decode_to_the_values_of_the_file(path: Path) -> None:
    """Read by its map from a server that gives these answers, each point has its value."""
    tables: dict[str, dict[int, list[int]]] = {}
    values: dict[str, Any] = {}
    for answer in answers_of(path):
        table, address, cells = cells_of(answer)
        tables.setdefault(table, {})[address] = cells
        values |= answer["values"] | dict.fromkeys(answer.get("missing", []))
    points = load_map(example_files.map_file(path.stem))
    with ServerMaker() as maker:
        server = maker(devices=Device(Mapping(**tables)))  # type: ignore[arg-type]
        with Client(server.url) as plc:
            results = plc.read_map(points)
    assert results == values
    assert set(values) == {name for name, point in points.items() if point.is_readable}


@each_case("path", DEVICES)
def test_a_map_names_its_sources_and_whether_it_was_tried(path: Path) -> None:
    contents = contents_of(example_files.map_file(path.stem), 1)
    assert not contents.mistakes
    lines = Path(example_files.map_file(path.stem)).read_text().splitlines()
    comment = " ".join(line.strip("# ") for line in lines if line.startswith("#"))
    match = re.search(r"Sources: (.*?)\. .*?Tried on: (.+)\.$", comment)
    assert match is not None, "a comment has 'Sources: ...; ....' and at last 'Tried on: ....'"
    assert len(match[1].split("; ")) >= 2, "two sources that agree, with ; between them"


def test_each_map_of_a_device_has_answers() -> None:
    """All maps that come with the package, but for the one that the tableation made up."""
    assert {path.stem for path in DEVICES} == set(example_files.maps()) - {"meter"}
    assert len(DEVICES) >= 20
