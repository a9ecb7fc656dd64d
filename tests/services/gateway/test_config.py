"""Gateway files and routes: what they describe, and every mistake with its line and key."""

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Access, Gateway, Route
from libmodbus_py.files.texts import FileError
from libmodbus_py.services.gateway import config
from libmodbus_py.services.gateway.routes import parse_route
from tests.support.golden import Refused

EXAMPLE = Path(__file__).parents[3] / "examples" / "gateway.toml"

TO = 'url = "tcp://192.0.2.1"\n'


def test_the_example_has_every_key_and_is_read() -> None:
    file = config.load(EXAMPLE)
    assert file.listen == ("tcp://127.0.0.1:1502", "udp://127.0.0.1:1502")
    first, looking = file.routes
    assert first.ways == {1: 255}
    assert (first.cache, first.merge, first.read_only) == (0.2, True, False)
    assert first.writable == ("coils", Access("holding_registers", 100, 20))
    assert looking.ways == {101: 255}
    assert looking.read_only
    assert file.options["queue"] == 16
    assert file.options["limits"].requests_per_second == 5000
    Gateway(file.routes, **file.options)
    text = EXAMPLE.read_text()
    for key in (*config.FILE, *config.ROUTE):
        assert key in text


def test_mistakes_are_reported_with_file_line_and_key(tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "gateway.toml"

    def load(text: str) -> None:
        path.write_text(text)
        try:
            config.load(path)
        except FileError as error:
            raise ValueError(str(error).replace(str(path), "FILE")) from None

    refused("wrong_files.txt", load)


@pytest.mark.parametrize(
    ("text", "ways"),
    [
        ("rtu:///dev/ttyUSB0?baudrate=9600", {unit: unit for unit in range(1, 248)}),
        ("1-2,9:11-12,19=tcp://192.0.2.1?timeout=1", {1: 11, 2: 12, 9: 19}),
        ("0-255:1=tcp://192.0.2.1", dict.fromkeys(range(256), 1)),
    ],
)
def test_routes_of_a_command_line_are_read(text: str, ways: dict[int, int]) -> None:
    assert parse_route(text).ways == ways


def test_wrong_arguments_of_a_gateway_are_refused() -> None:
    routes = [Route("tcp://192.0.2.1")]
    wrong: list[tuple[Any, dict[str, Any]]] = [
        (routes[0], {}),
        ([], {}),
        (["tcp://192.0.2.1"], {}),
        (routes, {"queue": 0}),
        (routes, {"longest_wait": 0}),
        (routes, {"writes_first": 1}),
        (routes, {"own_units": "1000"}),
        (routes, {"authorize": 3}),
        (routes, {"limits": {}}),
        (routes, {"security": "x"}),
    ]
    for row, options in wrong:
        with pytest.raises((TypeError, ValueError)):
            Gateway(row, **options)
    Gateway(routes, own_units=())
