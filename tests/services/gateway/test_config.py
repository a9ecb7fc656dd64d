"""Gateway files and routes: what they describe, and every mistake with its line and key."""

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Access, Gateway, Route
from libmodbus_py.files.texts import FileError
from libmodbus_py.services.gateway import config
from libmodbus_py.services.gateway.routes import parse_route

EXAMPLE = Path(__file__).parents[3] / "examples" / "gateway.toml"

TO = 'url = "tcp://192.0.2.1"\n'


def test_the_example_has_every_key_and_is_read() -> None:
    file = config.load(EXAMPLE)
    assert file.listen == ("tcp://127.0.0.1:1502", "udp://127.0.0.1:1502")
    shared, looking = file.routes
    assert shared.ways == {1: 255}
    assert (shared.cache, shared.merge, shared.read_only) == (0.2, True, False)
    assert shared.writable == ("coils", Access("holding_registers", 100, 20))
    assert looking.ways == {101: 255}
    assert looking.read_only
    assert file.options["queue"] == 16
    assert file.options["limits"].requests_per_second == 5000
    Gateway(file.routes, **file.options)
    text = EXAMPLE.read_text()
    for key in (*config.FILE, *config.ROUTE):
        assert key in text


WRONG: dict[str, tuple[str, int, str]] = {
    "no route": ("queue = 1\n", 1, "route must hold at least one table"),
    "no such key": ("colour = 1\n[[route]]\n" + TO, 1, "colour: no such key; allowed are listen"),
    "nowhere": ("[[route]]\nunits = [1]\n", 1, "route[0].url is missing"),
    "another word": ('[[route]]\nto = "tcp://192.0.2.1"\n', 2, "; did you mean url?"),
    "no URL": ('[[route]]\nurl = "192.0.2.1:x"\n', 2, "must be a URL"),
    "unknown port": (
        '[[route]]\nurl = "rtu:///dev/nowhere"\n',
        2,
        "there is no serial port /dev/nowhere",
    ),
    "units, twice": (f"[[route]]\n{TO}units = [4, 4]\n", 3, "units: 4 is given twice"),
    "two routes": (
        f"[[route]]\n{TO}units = [4]\n[[route]]\n{TO}units = [5, 4]\n",
        6,
        "route[1].units: an earlier route has unit 4 already",
    ),
    "two ways to one place": (
        f'[[route]]\n{TO}units = [1]\n[[route]]\nurl = "tcp://192.0.2.1?timeout=2"\nunits = [2]\n',
        5,
        "route[0] has other options for the same",
    ),
    "a circle": (
        'listen = ["tcp://0.0.0.0:1502"]\n[[route]]\nurl = "tcp://localhost:1502"\n',
        3,
        "the gateway itself listens on tcp://0.0.0.0:1502",
    ),
    "writable": (f'[[route]]\n{TO}writable = ["inputs"]\n', 3, "must be one of coils"),
    "wrong type": (f'queue = "x"\n[[route]]\n{TO}', 1, "queue must be an integer in 1..1024"),
    "own units": (f"own_units = [256]\n[[route]]\n{TO}", 1, "own_units[0] must be in 0..255"),
    "listen": (f'listen = ["tcp://:1"]\n[[route]]\n{TO}', 1, "listen[0]: 'tcp://:1': must be HOST"),
    "listen with options": (
        f'listen = ["tcp://127.0.0.1?timeout=1"]\n[[route]]\n{TO}',
        1,
        "timeout is for clients",
    ),
    "roles": (f'[roles.""]\nread = ["x"]\n[[route]]\n{TO}', 2, "must be one of coils"),
    "no TOML": ("listen = [\n", 2, ""),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes_are_told_with_file_line_and_key(tmp_path: Path, name: str) -> None:
    text, line, said = WRONG[name]
    path = tmp_path / "gateway.toml"
    path.write_text(text)
    with pytest.raises(FileError) as seen:
        config.load(path)
    if name not in ("no TOML", "no route"):
        assert str(seen.value).startswith(f"{path}, line {line}: ")
    assert str(path) in str(seen.value)
    assert said in str(seen.value)


@pytest.mark.parametrize(
    ("text", "ways"),
    [
        ("rtu:///dev/ttyUSB0?baudrate=9600", {unit: unit for unit in range(1, 248)}),
        ("1-2,9:11-12,19=tcp://192.0.2.1?timeout=1", {1: 11, 2: 12, 9: 19}),
        ("0-255:1=tcp://192.0.2.1", dict.fromkeys(range(256), 1)),
    ],
)
def test_routes_of_a_command_line(text: str, ways: dict[int, int]) -> None:
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
    for given, options in wrong:
        with pytest.raises((TypeError, ValueError)):
            Gateway(given, **options)
    Gateway(routes, own_units=())
