"""
Every help has examples.
"""

from __future__ import annotations

from tests.support.cases import each_case
from tests.support.commands import run


@each_case(
    "name",
    [
        "certificates",
        "completion",
        "fleet",
        "gateway",
        "listen",
        "map",
        "poll",
        "ports",
        "scan",
        "serve",
        "sunspec",
    ],
)
def test_help_of_others_has_four_examples(name: str) -> None:
    text = run(name, "--help").out
    examples = text.partition("examples:\n")[2].partition("\n\n")[0].splitlines()
    assert len([line for line in examples if "libmodbus-py" in line]) == 4
    assert name in text


@each_case("name", ["read", "write", "identify", "diagnose", "raw"])
def test_help_has_four_examples_and_the_urls(name: str) -> None:
    text = run(name, "--help").out
    examples = [line for line in text.splitlines() if line.startswith(f"  libmodbus-py {name} ")]
    assert len(examples) == 4
    assert '"tcp://192.0.2.10?unit=7&timeout=2"' in text
    for each in examples:
        assert "&" not in each.replace("'tcp://192.0.2.10?unit=7&timeout=0.5'", "").replace(
            "'rtu:///dev/ttyUSB0?baudrate=9600&unit=7'", ""
        )


@each_case("action", ["check", "list", "class", "from-device", "from-sunspec"])
def test_help_of_actions_of_map_has_four_examples(action: str) -> None:
    text = run("map", action, "--help").out
    examples = text.partition("examples:\n")[2].partition("\n\n")[0].splitlines()
    assert len([line for line in examples if "libmodbus-py" in line]) == 4
